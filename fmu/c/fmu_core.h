/* What a unit is, whatever the FMI version: its variables, its state, its step.
 *
 * The equations are CasADi's (model.c), the table of variables is generated (variables.h and
 * variables.c); all that is here is written by hand. A call that is refused leaves the instance
 * as it was and writes one sentence to `message`.
 */
#ifndef UNIT_H
#define UNIT_H

#include <stddef.h>
#include <stdint.h>

#include "model.h"
#include "variables.h"

#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define ROOM(n) MAX(n, 1) /* C has no empty arrays */
#define WORK(SIZE)                                                                        \
    ROOM(MAX(MAX(MAX(model_initial_##SIZE, model_begin_##SIZE),                           \
                 MAX(model_flow_##SIZE, model_finish_##SIZE)), model_output_##SIZE))

/* Where an instance stands; a set of them is the mask of states in which a call is legal. */
typedef enum {
    INSTANTIATED = 1,
    INITIALIZING = 2,
    STEPPING = 4,
    TERMINATED = 8,
    ANY_STATE = 15
} Mode;

typedef enum { FLOAT64, BOOLEAN } Type;
typedef enum { INDEPENDENT, INPUT, PARAMETER, OUTPUT } Causality;

typedef struct {
    const char *name;
    Type type;
    Causality causality;
    double start, minimum, maximum;
} Variable;

extern const Variable VARIABLES[N_VARIABLES]; /* the index is the value reference */

/* Everything that a saved state holds. */
typedef struct {
    double value[N_VARIABLES]; /* time, inputs, parameters, outputs */
    double state[ROOM(N_STATES)];
    int32_t mode;
    int32_t stale; /* the outputs do not follow the other values yet */
} Memory;

typedef struct {
    char token[sizeof UNIT_TOKEN]; /* a state fits only the unit that it comes from */
    Memory memory;
} Saved;

typedef struct {
    Memory memory;
    char message[256];
    const casadi_real *argument[WORK(SZ_ARG)]; /* what CasADi's functions work on */
    casadi_real *result[WORK(SZ_RES)];
    casadi_int integers[WORK(SZ_IW)];
    casadi_real reals[WORK(SZ_W)];
    double next[ROOM(N_STATES)];
} Unit;

/* All of these return 1 where the call went well, else 0 with a message. */
int unit_allow(Unit *unit, const char *call, int modes);
int unit_refuse(Unit *unit, const char *format, ...);
int unit_set(Unit *unit, const uint32_t reference[], size_t count, const double value[]);
int unit_get(Unit *unit, const uint32_t reference[], size_t count, double value[]);
int unit_check_type(Unit *unit, const uint32_t reference[], size_t count, Type type);
int unit_start_at(Unit *unit, double start_s);
int unit_exit_initialization(Unit *unit);
int unit_step(Unit *unit, double time_s, double step_s);
int unit_save(Unit *unit, Saved **saved);
int unit_restore(Unit *unit, const Saved *saved);
int unit_check_saved(Unit *unit, const void *bytes, size_t size);

void unit_reset(Unit *unit);

#endif
