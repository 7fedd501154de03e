/* Core of an FMU, independent of the FMI version: variables, states of the instance, steps.
 *
 * CasADi writes the equations (model.c), fmu/variables_c.py the table of variables (variables.h and
 * variables.c). A call that is refused leaves the instance unchanged and writes one sentence to
 * `message`.
 */
#ifndef FMU_CORE_H
#define FMU_CORE_H

#include <stddef.h>
#include <stdint.h>

#include "model.h"
#include "variables.h"

#define MAX(a, b) ((a) > (b) ? (a) : (b))
#define ROOM(n) MAX(n, 1) /* C has no empty arrays */
#define WORK(SIZE)                                                                        \
    ROOM(MAX(MAX(MAX(model_initial_##SIZE, model_begin_##SIZE),                           \
                 MAX(model_flow_##SIZE, model_finish_##SIZE)), model_output_##SIZE))

/* States of an instance; a set of them is a mask. */
typedef enum { INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8 } Mode;

/* Masks of the states in which a call is legal for Co-Simulation without event mode
 * (FMI 2.0, section 4.2.4; FMI 3.0, section 4.2). FMI 3.0 also allows a get before
 * initialization, see fmi3.c. */
enum {
    ANY_STATE = INSTANTIATED | INITIALIZING | STEPPING | TERMINATED,
    LEGAL_TO_SET = INSTANTIATED | INITIALIZING | STEPPING,
    LEGAL_TO_GET = INITIALIZING | STEPPING | TERMINATED,
    LEGAL_TO_ENTER = INSTANTIATED,
    LEGAL_TO_EXIT = INITIALIZING,
    LEGAL_TO_STEP = STEPPING,
    LEGAL_TO_TERMINATE = STEPPING
};

typedef enum { FLOAT64, BOOLEAN } Type;
typedef enum { INDEPENDENT, INPUT, PARAMETER, OUTPUT } Causality;

typedef struct {
    const char *name;
    Type type;
    Causality causality;
    double start, minimum, maximum;
} Variable;

enum { N_OUTPUTS = N_VARIABLES - FIRST_OUTPUT };

extern const Variable VARIABLES[N_VARIABLES]; /* the index is the value reference */

/* Content of a saved state. */
typedef struct {
    double value[N_VARIABLES]; /* time, inputs, parameters, outputs */
    double state[ROOM(N_STATES)];
    double stop_s; /* end of the experiment; infinite where the host defines none */
    int32_t mode;
    int32_t stale; /* the outputs are older than the other values */
} Memory;

typedef struct {
    uint64_t hash; /* of all bytes behind it */
    char token[sizeof FMU_TOKEN]; /* a state is valid only for the FMU that saved it */
    Memory memory;
} Saved;

typedef struct {
    Memory memory;
    char message[256];
    const casadi_real *argument[WORK(SZ_ARG)]; /* work memory of CasADi's functions */
    casadi_real *result[WORK(SZ_RES)];
    casadi_int integers[WORK(SZ_IW)];
    casadi_real reals[WORK(SZ_W)];
    double next[ROOM(N_STATES)];
    double outputs[ROOM(N_OUTPUTS)];
} Fmu;

/* Functions that return int return 1 on success, else 0 with a message; fmu_step also DISCARDED,
 * where a smaller step may succeed. */
enum { DISCARDED = 2 };

int fmu_refuse(Fmu *fmu, const char *format, ...);
int fmu_not_offered(Fmu *fmu, const char *call);
int fmu_allow(Fmu *fmu, const char *call, int legal);

void fmu_reset(Fmu *fmu);
int fmu_check_token(Fmu *fmu, const char *token, const char *what);
int fmu_check_log_categories(Fmu *fmu, const char *const category[], size_t count);
int fmu_start_at(Fmu *fmu, double start_s, int stop_defined, double stop_s);
int fmu_enter_initialization(Fmu *fmu);
int fmu_exit_initialization(Fmu *fmu);
int fmu_step(Fmu *fmu, double time_s, double step_s);
int fmu_terminate(Fmu *fmu);

int fmu_set_float64(Fmu *fmu, const uint32_t reference[], size_t count, const double value[]);
int fmu_get_float64(Fmu *fmu, const uint32_t reference[], size_t count, double value[]);
int fmu_check_booleans(Fmu *fmu, const uint32_t reference[], size_t count);
int fmu_get_boolean(Fmu *fmu, uint32_t reference, int *truth); /* after fmu_check_booleans */

int fmu_save(Fmu *fmu, Saved **saved);
int fmu_restore(Fmu *fmu, const Saved *saved);
void fmu_free_saved(void **saved);
int fmu_serialize(Fmu *fmu, const Saved *saved, void *bytes, size_t size);
int fmu_deserialize(Fmu *fmu, const void *bytes, size_t size, Saved **saved);

#endif
