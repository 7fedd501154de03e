/* Run a sampled model together with the slope S = dx/dp of its states by the chosen parameters, for
 * N_LANES trials in lockstep.
 *
 * The slope follows the variational equation S' = f_x S + f_p by the Runge-Kutta steps of the run
 * itself, so it is the derivative of the discrete run. Values and entries of the Jacobians are
 * evaluated for all trials at once, one in each lane. The slope of a trial is cut into blocks of
 * columns, one for each wanted parameter; a step is done block by block, so that a block stays in
 * the processor's first cache. Every operation is done element by element and rounded by itself, so
 * neither lanes nor blocks change a bit.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include "lanes.h"

/* Places of the entries of a sparse Jacobian, row after row. Entries x_start[k] to x_start[k + 1]
 * belong to row[k]; x_place is the row of S that an entry multiplies, p_place a column. */
typedef struct {
    int rows;
    const int *row, *x_start, *x_place, *p_start, *p_place;
} Jacobian;

#include "tables.h"

typedef double Block __attribute__((vector_size(N_BLOCK * sizeof(double)), may_alias));
typedef Block Slope[N_BLOCKS][N_ROWS];

typedef void Function(const Real **, Real **, int);
Function sensitivity_constants;
Function sensitivity_begin, sensitivity_rate, sensitivity_finish, sensitivity_output;

/* Entries of the derivatives of a function, side by side for each lane. */
typedef struct {
    double by_x[N_LANES][MOST_BY_X], by_p[N_LANES][MOST_BY_P];
} Entries;

/* Entries by p in the order in which they add to each block: to a column of the k-th row. */
typedef struct {
    int start[N_BLOCKS + 1], k[MOST_BY_P], column[MOST_BY_P], entry[MOST_BY_P];
} Additions;

typedef struct {
    Slope slope[N_LANES];
    Block change[N_ROWS + N_OUTPUTS], stage[N_ROWS], sum[N_ROWS];
    Entries stages[4];
    Real value[MOST_VALUES], by_x[MOST_BY_X], by_p[MOST_BY_P];
    Real x[N_STATES], x_stage[N_STATES], x_sum[N_STATES], u[N_INPUTS + 1], p[N_PARAMETERS + 1];
    Real constants[N_CONSTANTS + 1]; /* of p and the length of a step alone */
    int lanes, columns, blocks, chosen[N_COLUMNS + 1]; /* wanted columns, as chosen parameters */
    Additions begin, rate, finish, output;
    const char *wanted; /* of each chosen parameter */
} Run;

static const double WEIGHT[4] = {1, 2, 2, 1}; /* of the stages of a Runge-Kutta step */

/* Additions of a Jacobian, where place[c] is the wanted column of column c, or -1. */
static void sort_additions(const Run *r, const Jacobian *j, const int *place, Additions *own) {
    int count = 0;
    for (int b = 0; b < r->blocks; b++) {
        own->start[b] = count;
        for (int k = 0; k < j->rows; k++)
            for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++) {
                const int c = place[j->p_place[e]];
                if (c < 0 || c / N_BLOCK != b) continue;
                own->k[count] = k, own->column[count] = c % N_BLOCK, own->entry[count++] = e;
            }
    }
    own->start[r->blocks] = count;
}

/* Wanted columns side by side, and the blocks that hold them. */
static void select_columns(Run *r, int *place) {
    r->columns = 0;
    for (int c = 0; c < N_COLUMNS; c++) {
        place[c] = r->wanted[CHOSEN[c]] ? r->columns : -1;
        if (r->wanted[CHOSEN[c]]) r->chosen[r->columns++] = CHOSEN[c];
    }
    r->blocks = (r->columns + N_BLOCK - 1) / N_BLOCK;
}

/* Values and entries of the derivatives of a function at a state. */
static void evaluate(Run *r, Function function, const Jacobian *j, const Additions *add,
                     const Real *x, const Real *time, Entries *own) {
    const Real *arg[] = {x, r->u, r->p, r->constants, time};
    Real *res[] = {r->value, r->by_x, r->by_p};
    function(arg, res, r->lanes);
    if (!r->blocks) return;
    for (int e = 0; e < j->x_start[j->rows]; e++)
        for (int l = 0; l < N_LANES; l++) own->by_x[l][e] = r->by_x[e][l];
    for (int i = 0; i < add->start[r->blocks]; i++)
        for (int l = 0; l < N_LANES; l++) own->by_p[l][i] = r->by_p[add->entry[i]][l];
}

/* Row k of by_x slope, of each row of the Jacobian, for a block of a lane. */
static void multiply(const Jacobian *j, const Entries *own, int lane, const Block *slope,
                     Block *result) {
    const double *by_x = own->by_x[lane];
    for (int k = 0; k < j->rows; k++) {
        Block sum = {0};
        for (int e = j->x_start[k]; e < j->x_start[k + 1]; e++)
            sum += by_x[e] * slope[j->x_place[e]];
        result[k] = sum;
    }
}

/* The same with by_p, for block b. */
static void propagate(const Jacobian *j, const Additions *add, const Entries *own, int lane, int b,
                      const Block *slope, Block *result) {
    multiply(j, own, lane, slope, result);
    for (int i = add->start[b]; i < add->start[b + 1]; i++)
        result[add->k[i]][add->column[i]] += own->by_p[lane][i];
}

/* State and slope after a discrete update. */
static void update(Run *r, Function function, const Jacobian *j, const Additions *add,
                   const Real *time) {
    Entries *own = r->stages;
    evaluate(r, function, j, add, r->x, time, own);
    memcpy(r->x, r->value, sizeof r->x);
    for (int lane = 0; lane < r->lanes; lane++)
        for (int b = 0; b < r->blocks; b++) {
            Block *slope = r->slope[lane][b];
            propagate(j, add, own, lane, b, slope, r->change);
            for (int k = 0; k < j->rows; k++) slope[j->row[k]] = r->change[k];
        }
}

/* A block of a lane's slope after a Runge-Kutta step, whose stages are evaluated. */
static void follow(Run *r, int lane, int b, double dt, const double *ahead) {
    const Jacobian *j = &RATE;
    Block *slope = r->slope[lane][b], *change = r->change;
    memcpy(r->stage, slope, sizeof r->stage);
    memset(r->sum, 0, sizeof r->sum);
    for (int s = 0; s < 4; s++) {
        propagate(j, &r->rate, &r->stages[s], lane, b, r->stage, change);
        for (int k = 0; k < j->rows; k++) {
            r->sum[k] += WEIGHT[s] * change[k];
            r->stage[j->row[k]] = slope[j->row[k]] + ahead[s] * change[k];
        }
    }
    for (int k = 0; k < j->rows; k++) slope[j->row[k]] += dt / 6 * r->sum[k];
}

/* One classical Runge-Kutta step, rounded like `runge_kutta` of models/plant/step_model.py. */
static void flow(Run *r, double dt) {
    const double ahead[4] = {dt / 2, dt / 2, dt, 0};
    memcpy(r->x_stage, r->x, sizeof r->x);
    memset(r->x_sum, 0, sizeof r->x_sum);
    for (int s = 0; s < 4; s++) {
        evaluate(r, sensitivity_rate, &RATE, &r->rate, r->x_stage, NULL, &r->stages[s]);
        for (int i = 0; i < N_STATES; i++) {
            r->x_sum[i] += WEIGHT[s] * r->value[i];
            r->x_stage[i] = r->x[i] + ahead[s] * r->value[i];
        }
    }
    for (int i = 0; i < N_STATES; i++) r->x[i] += dt / 6 * r->x_sum[i];
    for (int lane = 0; lane < r->lanes; lane++)
        for (int b = 0; b < r->blocks; b++) follow(r, lane, b, dt, ahead);
}

/* Outputs y of a lane, and their slopes: of each output by all chosen parameters, zero by unwanted
 * ones. */
static void observe(Run *r, int lane, double *y, double *slope) {
    const Jacobian *j = &OUTPUT;
    for (int k = 0; k < N_OUTPUTS; k++) y[k] = r->value[k][lane];
    memset(slope, 0, N_OUTPUTS * N_CHOSEN * sizeof *slope);
    for (int b = 0; b < r->blocks; b++) {
        multiply(j, r->stages, lane, r->slope[lane][b], r->change);
        for (int c = b * N_BLOCK; c < r->columns && c < (b + 1) * N_BLOCK; c++)
            for (int k = 0; k < N_OUTPUTS; k++)
                slope[k * N_CHOSEN + r->chosen[c]] = r->change[k][c % N_BLOCK];
    }
    for (int k = 0; k < N_OUTPUTS; k++, slope += N_CHOSEN)
        for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++)
            if (r->wanted[j->p_place[e]]) slope[j->p_place[e]] += r->by_p[e][lane];
}

/* Parameters, states at the start and their slopes, of which only wanted columns are kept. */
static void begin_run(Run *r, const int *place, const double *p, const double *x,
                      const double *slope) {
    memset(r->slope, 0, sizeof r->slope);
    for (int l = 0; l < N_LANES; l++) {
        const int lane = l < r->lanes ? l : r->lanes - 1;
        for (int i = 0; i < N_PARAMETERS; i++) r->p[i][l] = p[lane * N_PARAMETERS + i];
        for (int i = 0; i < N_STATES; i++) r->x[i][l] = x[lane * N_STATES + i];
        for (int k = 0; k < N_ROWS; k++)
            for (int c = 0; c < N_COLUMNS; c++) {
                const int own = place[c];
                if (own < 0) continue;
                r->slope[l][own / N_BLOCK][k][own % N_BLOCK] =
                    slope[(lane * N_ROWS + k) * N_COLUMNS + c];
            }
    }
}

/* Inputs of a step; lanes that are left over repeat the last. */
static void read_inputs(Run *r, const double *u, long steps, long k) {
    for (int i = 0; i < N_INPUTS; i++)
        for (int l = 0; l < N_LANES; l++) {
            const long lane = l < r->lanes ? l : r->lanes - 1;
            r->u[i][l] = u[(lane * steps + k) * N_INPUTS + i];
        }
}

static void observe_all(Run *r, long rows, long k, double *y, double *slope) {
    evaluate(r, sensitivity_output, &OUTPUT, &r->output, r->x, NULL, r->stages);
    for (long l = 0; l < r->lanes; l++) {
        const long row = (l * rows + k) * N_OUTPUTS;
        observe(r, l, y + row, slope + row * N_CHOSEN);
    }
}

static void run_all(Run *r, long steps, double step_s, double max_substep_s, const double *first,
                    const double *u, double *y, double *slope) {
    const double substeps = fmax(1.0, ceil(step_s / max_substep_s - 1e-9)), dt = step_s / substeps;
    const Real time = EACH(step_s);
    const Real *arg[] = {r->p, &time};
    Real *res[] = {r->constants};
    sensitivity_constants(arg, res, r->lanes);
    read_inputs(r, steps ? u : first, steps ? steps : 1, 0);
    observe_all(r, steps + 1, 0, y, slope);
    for (long k = 0; k < steps; k++) {
        read_inputs(r, u, steps, k);
        update(r, sensitivity_begin, &BEGIN, &r->begin, &time);
        for (long i = 0; i < (long)substeps; i++) flow(r, dt);
        update(r, sensitivity_finish, &FINISH, &r->finish, &time);
        observe_all(r, steps + 1, k + 1, y, slope);
    }
}

/* Outputs y and their slopes at the start and after each step, of `lanes` trials one after the
 * other, at most N_LANES. x and x_slope are the state at the start, and its slope in N_ROWS rows
 * and N_COLUMNS columns; `first` are the inputs there, u[k] drives step k. `wanted` holds 1 for each
 * chosen parameter whose slopes are asked for. Returns 0, or 1 when memory is short. */
__attribute__((visibility("default"))) int run_sensitive(
    int lanes, long steps, double step_s, double max_substep_s, const char *wanted,
    const double *first, const double *u, const double *p, const double *x, const double *x_slope,
    double *y, double *slope) {
    const size_t boundary = 256;
    void *memory = malloc(sizeof(Run) + boundary);
    if (!memory) return 1;
    Run *r = (Run *)((char *)memory + boundary - (uintptr_t)memory % boundary);
    r->lanes = lanes, r->wanted = wanted;
    int place[N_COLUMNS + 1];
    select_columns(r, place);
    const Jacobian *all[] = {&BEGIN, &RATE, &FINISH};
    Additions *add[] = {&r->begin, &r->rate, &r->finish};
    for (int k = 0; k < 3; k++) sort_additions(r, all[k], place, add[k]);
    memset(r->output.start, 0, sizeof r->output.start); /* `observe` adds these itself */
    begin_run(r, place, p, x, x_slope);
    run_all(r, steps, step_s, max_substep_s, first, u, y, slope);
    free(memory);
    return 0;
}
