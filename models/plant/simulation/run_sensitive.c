/* Run a sampled model together with the slope S = dx/dp of its states by the chosen parameters.
 *
 * The slope follows the variational equation S' = f_x S + f_p by the Runge-Kutta steps of the run
 * itself, so it is the derivative of the discrete run. A row of S belongs to a state, with all
 * parameters side by side: a row times an entry of f_x is a loop over vectors. Every operation is
 * done element by element and rounded by itself, so the width of the vectors changes no bit. Blocks
 * of parameters that no one asks for are left out.
 */
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "sensitivity.h"
#include "sensitivity_initial.h"

/* Places of the entries of a sparse Jacobian, row after row. Entries x_start[k] to x_start[k + 1]
 * belong to row[k]; x_place is the row of S that an entry multiplies, p_place a column. */
typedef struct {
    int rows;
    const int *row, *x_start, *x_place, *p_start, *p_place;
} Jacobian;

#include "tables.h"

typedef double Block __attribute__((vector_size(N_BLOCK * sizeof(double)), may_alias));
typedef Block Row[N_BLOCKS];

typedef int (*Function)(const double **, double **, casadi_int *, double *, int);
typedef int (*Work)(casadi_int *, casadi_int *, casadi_int *, casadi_int *);

static const Work WORK[] = {sensitivity_initial_work, sensitivity_begin_work, sensitivity_rate_work,
                            sensitivity_finish_work, sensitivity_output_work};

typedef struct {
    Row slope[N_ROWS], stage[N_ROWS], change[N_ROWS], sum[N_ROWS], output[N_OUTPUTS];
    double x[N_STATES], x_stage[N_STATES], x_sum[N_STATES];
    double value[MOST_VALUES], by_x[MOST_BY_X], by_p[MOST_BY_P];
    const double *u, *p, **arg;
    double **res, *w;
    casadi_int *iw;
    const char *wanted; /* of each chosen parameter */
    int blocks, block[N_BLOCKS];
} Run;

/* Blocks of columns that hold a wanted parameter. */
static void select_blocks(Run *r) {
    r->blocks = 0;
    for (int b = 0; b < N_BLOCKS; b++) {
        int any = 0;
        for (int c = b * N_BLOCK; c < N_COLUMNS && c < (b + 1) * N_BLOCK; c++)
            any |= r->wanted[CHOSEN[c]];
        if (any) r->block[r->blocks++] = b;
    }
}

/* Values and entries of the derivatives of a function at a state. */
static void evaluate(Run *r, Function function, const double *x, const double *time) {
    r->arg[0] = x, r->arg[1] = r->u, r->arg[2] = r->p, r->arg[3] = time;
    r->res[0] = r->value, r->res[1] = r->by_x, r->res[2] = r->by_p;
    function(r->arg, r->res, r->iw, r->w, 0);
}

/* Row k of by_x slope + by_p, of each row of the Jacobian. */
static void multiply(const Jacobian *j, const Run *r, const Row *slope, Row *result) {
    for (int k = 0; k < j->rows; k++) {
        Row sum;
        memset(sum, 0, sizeof sum);
        for (int e = j->x_start[k]; e < j->x_start[k + 1]; e++) {
            const Block *other = slope[j->x_place[e]];
            for (int i = 0; i < r->blocks; i++)
                sum[r->block[i]] += r->by_x[e] * other[r->block[i]];
        }
        memcpy(result[k], sum, sizeof sum);
    }
}

/* The same with by_p, for states. */
static void propagate(const Jacobian *j, const Run *r, const Row *slope, Row *result) {
    multiply(j, r, slope, result);
    for (int k = 0; k < j->rows; k++)
        for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++) {
            const int c = j->p_place[e];
            result[k][c / N_BLOCK][c % N_BLOCK] += r->by_p[e];
        }
}

/* Rows of the slope after a discrete update of the state. */
static void replace_rows(Run *r, const Jacobian *j) {
    propagate(j, r, r->slope, r->change);
    for (int k = 0; k < j->rows; k++) memcpy(r->slope[j->row[k]], r->change[k], sizeof(Row));
}

/* State and slope after a discrete update. */
static void update(Run *r, Function function, const Jacobian *j, const double *time) {
    evaluate(r, function, r->x, time);
    memcpy(r->x, r->value, sizeof r->x);
    replace_rows(r, j);
}

/* One of the four evaluations of a Runge-Kutta step: adds weight times the rate to the sums, and
 * advances the stage by `ahead` times the rate from the start of the step. */
static void evaluate_stage(Run *r, double weight, double ahead) {
    const Jacobian *j = &RATE;
    evaluate(r, sensitivity_rate, r->x_stage, NULL);
    propagate(j, r, r->stage, r->change);
    for (int i = 0; i < N_STATES; i++) {
        r->x_sum[i] += weight * r->value[i];
        r->x_stage[i] = r->x[i] + ahead * r->value[i];
    }
    for (int k = 0; k < j->rows; k++) {
        Block *stage = r->stage[j->row[k]], *start = r->slope[j->row[k]];
        for (int i = 0; i < r->blocks; i++) {
            const int b = r->block[i];
            r->sum[k][b] += weight * r->change[k][b];
            stage[b] = start[b] + ahead * r->change[k][b];
        }
    }
}

/* One classical Runge-Kutta step, rounded like `runge_kutta` of models/plant/step_model.py. */
static void flow(Run *r, double dt) {
    const Jacobian *j = &RATE;
    memcpy(r->x_stage, r->x, sizeof r->x);
    memcpy(r->stage, r->slope, sizeof r->slope);
    memset(r->x_sum, 0, sizeof r->x_sum);
    memset(r->sum, 0, sizeof r->sum);
    evaluate_stage(r, 1, dt / 2);
    evaluate_stage(r, 2, dt / 2);
    evaluate_stage(r, 2, dt);
    evaluate_stage(r, 1, 0);
    for (int i = 0; i < N_STATES; i++) r->x[i] += dt / 6 * r->x_sum[i];
    for (int k = 0; k < j->rows; k++)
        for (int i = 0; i < r->blocks; i++)
            r->slope[j->row[k]][r->block[i]] += dt / 6 * r->sum[k][r->block[i]];
}

/* Outputs y, and their slopes: of each output by all chosen parameters, zero by unwanted ones. */
static void observe(Run *r, double *y, double *slope) {
    const Jacobian *j = &OUTPUT;
    evaluate(r, sensitivity_output, r->x, NULL);
    memcpy(y, r->value, N_OUTPUTS * sizeof *y);
    multiply(j, r, r->slope, r->output);
    memset(slope, 0, N_OUTPUTS * N_CHOSEN * sizeof *slope);
    for (int k = 0; k < N_OUTPUTS; k++, slope += N_CHOSEN) {
        for (int c = 0; c < N_COLUMNS; c++)
            if (r->wanted[CHOSEN[c]]) slope[CHOSEN[c]] = r->output[k][c / N_BLOCK][c % N_BLOCK];
        for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++)
            if (r->wanted[j->p_place[e]]) slope[j->p_place[e]] += r->by_p[e];
    }
}

static void run_all(Run *r, long steps, double step_s, double max_substep_s, const double *u,
                    double *y, double *slope) {
    double substeps = fmax(1.0, ceil(step_s / max_substep_s - 1e-9)), dt = step_s / substeps;
    r->arg[0] = r->u, r->arg[1] = r->p;
    r->res[0] = r->x, r->res[1] = r->by_x, r->res[2] = r->by_p;
    sensitivity_initial(r->arg, r->res, r->iw, r->w, 0);
    memset(r->slope, 0, sizeof r->slope);
    replace_rows(r, &INITIAL);
    r->u = u;
    observe(r, y, slope);
    for (long k = 0; k < steps; k++) {
        r->u = u + k * N_INPUTS;
        update(r, sensitivity_begin, &BEGIN, &step_s);
        for (long i = 0; i < (long)substeps; i++) flow(r, dt);
        update(r, sensitivity_finish, &FINISH, &step_s);
        observe(r, y + (k + 1) * N_OUTPUTS, slope + (k + 1) * N_OUTPUTS * N_CHOSEN);
    }
}

/* Outputs y and their slopes at the start and after each step. The state at the start is the one at
 * rest under the inputs `first`; u[k] drives step k. `wanted` holds 1 for each chosen parameter
 * whose slopes are asked for. Returns 0, or 1 when memory is short. */
__attribute__((visibility("default"))) int run_sensitive(long steps, double step_s,
                                                         double max_substep_s, const char *wanted,
                                                         const double *first, const double *u,
                                                         const double *p, double *y,
                                                         double *slope) {
    casadi_int sizes[4] = {4, 3, 1, 1}; /* arguments, results, integers, doubles */
    for (int k = 0; k < 5; k++) {
        casadi_int need[4];
        WORK[k](&need[0], &need[1], &need[2], &need[3]);
        for (int i = 0; i < 4; i++)
            if (need[i] > sizes[i]) sizes[i] = need[i];
    }
    void *memory = malloc(sizeof(Run) + sizeof(Block));
    const double **arg = malloc(sizes[0] * sizeof *arg);
    double **res = malloc(sizes[1] * sizeof *res);
    casadi_int *iw = malloc(sizes[2] * sizeof *iw);
    double *w = malloc(sizes[3] * sizeof *w);
    int failed = !memory || !arg || !res || !iw || !w;
    if (!failed) {
        size_t beyond = (size_t)memory % sizeof(Block);
        Run *r = (Run *)((char *)memory + sizeof(Block) - beyond);
        r->u = first, r->p = p, r->arg = arg, r->res = res, r->iw = iw, r->w = w;
        r->wanted = wanted;
        select_blocks(r);
        run_all(r, steps, step_s, max_substep_s, u, y, slope);
    }
    free(memory);
    free(arg);
    free(res);
    free(iw);
    free(w);
    return failed;
}
