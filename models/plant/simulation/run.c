/* Run a sampled model, together with the slope S = dx/dp of its states by the chosen parameters.
 *
 * The slope follows the variational equation S' = f_x S + f_p by the Runge-Kutta steps of the run
 * itself, so it is the derivative of the discrete run. The columns of S, one for each wanted
 * parameter, are cut into blocks; a step is done block by block, so that a block stays in the
 * processor's first cache. Every operation is rounded by itself, so neither blocks nor vectors
 * change a bit. Without wanted columns this is the plain run.
 */
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

/* Places of the entries of a sparse Jacobian, row after row. Entries x_start[k] to x_start[k + 1]
 * belong to row[k]; x_place is the row of S that an entry multiplies, p_place a column. */
typedef struct {
    int rows;
    const int *row, *x_start, *x_place, *p_start, *p_place;
} Jacobian;

#include "tables.h"

typedef double Block __attribute__((vector_size(N_BLOCK * sizeof(double)), may_alias));
typedef Block Slope[N_BLOCKS][N_ROWS];

/* CasADi's convention; functions of scalar operations need no scratch memory. Their results are the
 * value, and the entries of the derivatives by states and by parameters. */
typedef int Function(const double **arg, double **res, long long *iw, double *w, int mem);
Function run_constants, run_begin, run_rate, run_finish, run_output;

typedef struct {
    double by_x[MOST_BY_X], by_p[MOST_BY_P];
} Entries;

/* Entries by p in the order in which they add to each block: to a column of the k-th row. */
typedef struct {
    int start[N_BLOCKS + 1], k[MOST_BY_P], column[MOST_BY_P], entry[MOST_BY_P];
} Additions;

typedef struct {
    Slope slope;
    Block change[N_ROWS + N_OUTPUTS], stage[N_ROWS], sum[N_ROWS];
    Entries stages[4];
    double value[MOST_VALUES], x[N_STATES], x_stage[N_STATES], x_sum[N_STATES];
    double constants[N_CONSTANTS + 1]; /* of p and the length of a step alone */
    int columns, blocks, chosen[N_COLUMNS + 1]; /* wanted columns, as chosen parameters */
    Additions begin, rate, finish;
    const char *wanted; /* of each chosen parameter */
    const double *u, *p;
} Run;

static const double WEIGHT[4] = {1, 2, 2, 1}; /* of the stages of a Runge-Kutta step */

/* Wanted columns side by side, and the blocks that hold them; place[c] is -1 for an unwanted one. */
static void select_columns(Run *r, int *place) {
    r->columns = 0;
    for (int c = 0; c < N_COLUMNS; c++) {
        place[c] = r->wanted[CHOSEN[c]] ? r->columns : -1;
        if (r->wanted[CHOSEN[c]]) r->chosen[r->columns++] = CHOSEN[c];
    }
    r->blocks = (r->columns + N_BLOCK - 1) / N_BLOCK;
}

static void sort_additions(const Run *r, const Jacobian *j, const int *place, Additions *add) {
    int count = 0;
    for (int b = 0; b < r->blocks; b++) {
        add->start[b] = count;
        for (int k = 0; k < j->rows; k++)
            for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++) {
                const int c = place[j->p_place[e]];
                if (c < 0 || c / N_BLOCK != b) continue;
                add->k[count] = k, add->column[count] = c % N_BLOCK, add->entry[count++] = e;
            }
    }
    add->start[r->blocks] = count;
}

static void evaluate(Run *r, Function function, const double *x, const double *time, Entries *to) {
    const double *arg[] = {x, r->u, r->p, r->constants, time};
    double *res[] = {r->value, to->by_x, to->by_p};
    function(arg, res, NULL, NULL, 0);
}

/* by_x times a block of the slope, row by row of the Jacobian. */
static void multiply(const Jacobian *j, const Entries *e, const Block *slope, Block *result) {
    for (int k = 0; k < j->rows; k++) {
        Block sum = {0};
        for (int i = j->x_start[k]; i < j->x_start[k + 1]; i++)
            sum += e->by_x[i] * slope[j->x_place[i]];
        result[k] = sum;
    }
}

/* The same plus by_p, for block b. */
static void propagate(const Jacobian *j, const Additions *add, const Entries *e, int b,
                      const Block *slope, Block *result) {
    multiply(j, e, slope, result);
    for (int i = add->start[b]; i < add->start[b + 1]; i++)
        result[add->k[i]][add->column[i]] += e->by_p[add->entry[i]];
}

/* State and slope after a discrete update. */
static void update(Run *r, Function function, const Jacobian *j, const Additions *add,
                   const double *time) {
    evaluate(r, function, r->x, time, r->stages);
    memcpy(r->x, r->value, sizeof r->x);
    for (int b = 0; b < r->blocks; b++) {
        propagate(j, add, r->stages, b, r->slope[b], r->change);
        for (int k = 0; k < j->rows; k++) r->slope[b][j->row[k]] = r->change[k];
    }
}

/* One classical Runge-Kutta step, rounded like `runge_kutta` of models/plant/step_model.py. */
static void flow(Run *r, double dt) {
    const double ahead[4] = {dt / 2, dt / 2, dt, 0};
    memcpy(r->x_stage, r->x, sizeof r->x);
    memset(r->x_sum, 0, sizeof r->x_sum);
    for (int s = 0; s < 4; s++) {
        evaluate(r, run_rate, r->x_stage, NULL, &r->stages[s]);
        for (int i = 0; i < N_STATES; i++) {
            r->x_sum[i] += WEIGHT[s] * r->value[i];
            r->x_stage[i] = r->x[i] + ahead[s] * r->value[i];
        }
    }
    for (int i = 0; i < N_STATES; i++) r->x[i] += dt / 6 * r->x_sum[i];
    for (int b = 0; b < r->blocks; b++) {
        Block *slope = r->slope[b], *change = r->change;
        memcpy(r->stage, slope, sizeof r->stage);
        memset(r->sum, 0, sizeof r->sum);
        for (int s = 0; s < 4; s++) {
            propagate(&RATE, &r->rate, &r->stages[s], b, r->stage, change);
            for (int k = 0; k < RATE.rows; k++) {
                r->sum[k] += WEIGHT[s] * change[k];
                r->stage[RATE.row[k]] = slope[RATE.row[k]] + ahead[s] * change[k];
            }
        }
        for (int k = 0; k < RATE.rows; k++) slope[RATE.row[k]] += dt / 6 * r->sum[k];
    }
}

/* Outputs y, and their slopes by all chosen parameters, zero by unwanted ones. */
static void observe(Run *r, double *y, double *slope) {
    const Jacobian *j = &OUTPUT;
    evaluate(r, run_output, r->x, NULL, r->stages);
    memcpy(y, r->value, N_OUTPUTS * sizeof *y);
    memset(slope, 0, N_OUTPUTS * N_CHOSEN * sizeof *slope);
    for (int b = 0; b < r->blocks; b++) {
        multiply(j, r->stages, r->slope[b], r->change);
        for (int c = b * N_BLOCK; c < r->columns && c < (b + 1) * N_BLOCK; c++)
            for (int k = 0; k < N_OUTPUTS; k++)
                slope[k * N_CHOSEN + r->chosen[c]] = r->change[k][c % N_BLOCK];
    }
    for (int k = 0; k < N_OUTPUTS; k++, slope += N_CHOSEN)
        for (int e = j->p_start[k]; e < j->p_start[k + 1]; e++)
            if (r->wanted[j->p_place[e]]) slope[j->p_place[e]] += r->stages[0].by_p[e];
}

/* Outputs y and their slopes at the start and after each step, which u[k] drives. x and x_slope are
 * the state at the start, and its slope in N_ROWS rows and N_COLUMNS columns. `wanted` holds 1 for
 * each chosen parameter whose slopes are asked for. Returns 0, or 1 when memory is short. */
__attribute__((visibility("default"))) int run(
    long steps, double step_s, double max_substep_s, const char *wanted, const double *u,
    const double *p, const double *x, const double *x_slope, double *y, double *slope) {
    const size_t boundary = 256;
    void *memory = malloc(sizeof(Run) + boundary);
    if (!memory) return 1;
    Run *r = (Run *)((char *)memory + boundary - (uintptr_t)memory % boundary);
    int place[N_COLUMNS + 1];
    r->wanted = wanted, r->p = p, r->u = u;
    select_columns(r, place);
    sort_additions(r, &BEGIN, place, &r->begin);
    sort_additions(r, &RATE, place, &r->rate);
    sort_additions(r, &FINISH, place, &r->finish);
    memcpy(r->x, x, sizeof r->x);
    memset(r->slope, 0, sizeof r->slope);
    for (int k = 0; k < N_ROWS; k++)
        for (int c = 0; c < N_COLUMNS; c++)
            if (place[c] >= 0)
                r->slope[place[c] / N_BLOCK][k][place[c] % N_BLOCK] = x_slope[k * N_COLUMNS + c];

    const double substeps = fmax(1.0, ceil(step_s / max_substep_s - 1e-9)), dt = step_s / substeps;
    const double *arg[] = {p, &step_s};
    double *res[] = {r->constants};
    run_constants(arg, res, NULL, NULL, 0);
    observe(r, y, slope);
    for (long k = 0; k < steps; k++) {
        r->u = u + k * N_INPUTS;
        update(r, run_begin, &BEGIN, &r->begin, &step_s);
        for (long i = 0; i < (long)substeps; i++) flow(r, dt);
        update(r, run_finish, &FINISH, &r->finish, &step_s);
        y += N_OUTPUTS, slope += N_OUTPUTS * N_CHOSEN;
        observe(r, y, slope);
    }
    free(memory);
    return 0;
}
