/* Run a sampled model over a sequence of inputs: the loop of models/plant/step_model.py in C.
 *
 * CasADi generates the five functions of the model; its calling convention takes arrays of
 * pointers to arguments and results, and scratch memory of the sizes that NAME_work tells.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "model.h"

typedef int (*Function)(const double **, double **, casadi_int *, double *, int);
typedef int (*Work)(casadi_int *, casadi_int *, casadi_int *, casadi_int *);

static const Work MODEL_WORK[] = {model_begin_work, model_flow_work, model_finish_work,
                                  model_output_work};

/* Outputs y[0] at the start x and y[k + 1] after step k, which u[k] drives. x ends as the last
 * state. Returns 0, or 1 when memory is short. */
__attribute__((visibility("default"))) int run(long steps, double step_s, double max_substep_s,
                                               const double *u, const double *p, double *x,
                                               double *y) {
    casadi_int sizes[4] = {4, 1, 1, 1}; /* arguments, results, integers, doubles */
    for (int k = 0; k < 4; k++) {
        casadi_int need[4];
        MODEL_WORK[k](&need[0], &need[1], &need[2], &need[3]);
        for (int i = 0; i < 4; i++)
            if (need[i] > sizes[i]) sizes[i] = need[i];
    }
    const double **arg = malloc(sizes[0] * sizeof *arg);
    double **res = malloc(sizes[1] * sizeof *res);
    casadi_int *iw = malloc(sizes[2] * sizeof *iw);
    double *w = malloc((sizes[3] + N_X) * sizeof *w), *next = w ? w + sizes[3] : NULL;
    int failed = !arg || !res || !iw || !w;
    const double *row = u;

#define EVALUATE(function, time, result)                        \
    (arg[0] = x, arg[1] = row, arg[2] = p, arg[3] = (time),     \
     res[0] = (result), function(arg, res, iw, w, 0))
#define ADVANCE(function, time) (EVALUATE(function, time, next), memcpy(x, next, N_X * sizeof *x))

    if (!failed) {
        double substeps = fmax(1.0, ceil(step_s / max_substep_s - 1e-9)), dt = step_s / substeps;
        EVALUATE(model_output, NULL, y);
        for (long k = 0; k < steps; k++, row += N_U) {
            ADVANCE(model_begin, &step_s);
            for (long i = 0; i < (long)substeps; i++) ADVANCE(model_flow, &dt);
            ADVANCE(model_finish, &step_s);
            EVALUATE(model_output, NULL, y + (k + 1) * N_Y);
        }
    }
    free(arg);
    free(res);
    free(iw);
    free(w);
    return failed;
}

/* State at rest under the input u. */
__attribute__((visibility("default"))) int start(const double *u, const double *p, double *x) {
    casadi_int need[4];
    model_initial_work(&need[0], &need[1], &need[2], &need[3]);
    const double **arg = malloc((need[0] + 2) * sizeof *arg);
    double **res = malloc((need[1] + 1) * sizeof *res);
    casadi_int *iw = malloc((need[2] + 1) * sizeof *iw);
    double *w = malloc((need[3] + 1) * sizeof *w);
    int failed = !arg || !res || !iw || !w;
    if (!failed) {
        arg[0] = u, arg[1] = p, res[0] = x;
        failed = model_initial(arg, res, iw, w, 0);
    }
    free(arg);
    free(res);
    free(iw);
    free(w);
    return failed;
}
