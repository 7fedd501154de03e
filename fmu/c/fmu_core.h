/* Core of an FMU, independent of the FMI version: variables, states of the instance, steps.
 *
 * CasADi writes the equations (model.c), fmu/interface.py the table of variables (variables.h and
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

/* States of an instance; a set of them is a mask. An instance for Co-Simulation is never in the
 * event mode or in continuous time, one for Model Exchange never steps. */
typedef enum {
    INSTANTIATED = 1, INITIALIZING = 2, STEPPING = 4, TERMINATED = 8, EVENT = 16, CONTINUOUS = 32
} Mode;

/* Masks of the states in which a call is legal, for Model Exchange and for Co-Simulation without
 * event mode (FMI 2.0, sections 3.2.3 and 4.2.4; FMI 3.0, sections 3.2 and 4.2). FMI 3.0 also
 * allows a get before initialization, see fmi3.c. */
enum {
    RUNNING = STEPPING | EVENT | CONTINUOUS,
    ANY_STATE = INSTANTIATED | INITIALIZING | RUNNING | TERMINATED,
    LEGAL_TO_SET = INSTANTIATED | INITIALIZING | RUNNING,
    LEGAL_TO_GET = INITIALIZING | RUNNING | TERMINATED,
    LEGAL_TO_ENTER = INSTANTIATED,
    LEGAL_TO_EXIT = INITIALIZING,
    LEGAL_TO_STEP = STEPPING,
    LEGAL_TO_TERMINATE = RUNNING,
    LEGAL_TO_UPDATE = EVENT,
    LEGAL_TO_INTEGRATE = CONTINUOUS,
    LEGAL_TO_SET_TIME = EVENT | CONTINUOUS,
    LEGAL_TO_EVALUATE = INITIALIZING | EVENT | CONTINUOUS | TERMINATED
};

/* A host that sums its steps arrives at rounded times; FMPy compares times to 1e-9. */
#define TIME_TOLERANCE 1e-9
#define LATEST_S 1e12 /* 30,000 years: a double still resolves 0.1 ms there */

/* Results that have to be computed again, because a value on which they depend has changed. */
enum { STALE_OUTPUTS = 1, STALE_RATES = 2, STALE_INDICATORS = 4, STALE = 7 };

typedef enum { FLOAT64, BOOLEAN } Type;
typedef enum { INDEPENDENT, INPUT, PARAMETER, OUTPUT, LOCAL } Causality;

typedef struct {
    const char *name;
    Type type;
    Causality causality;
    int sampled; /* in Model Exchange the value changes only at events */
    double start, minimum, maximum;
} Variable;

enum {
    N_INPUTS = FIRST_PARAMETER - FIRST_INPUT,
    N_PARAMETERS = FIRST_OUTPUT - FIRST_PARAMETER - WITH_EXAMPLE, /* without example.scale */
    N_OUTPUTS = FIRST_STATE - FIRST_OUTPUT,
    N_CONTINUOUS = FIRST_INDICATOR - FIRST_DERIVATIVE,
    N_INDICATORS = N_VARIABLES - FIRST_INDICATOR,
    N_KNOWNS = N_STATES + N_INPUTS + N_PARAMETERS,
    N_RESPONSE = N_OUTPUTS + N_CONTINUOUS + N_INDICATORS,
    N_UNKNOWNS = N_RESPONSE + N_STATES
};

extern const Variable VARIABLES[N_VARIABLES]; /* the index is the value reference */
extern const int CONTINUOUS_STATES[ROOM(N_CONTINUOUS)]; /* indices into the states */
extern const double NOMINALS[ROOM(N_CONTINUOUS)];
extern const double EXAMPLE[ROOM(N_INPUTS)]; /* amplitudes of the example motion */

/* Contents of a saved state. */
typedef struct {
    double value[FIRST_STATE]; /* time, inputs, parameters, outputs */
    double state[ROOM(N_STATES)];
    double start_s;
    double stop_s; /* end of the experiment; infinite if the host defines none */
    double samples; /* their number in Model Exchange; the next: start + samples * SAMPLE_S */
    int32_t mode;
    int32_t stale;
    int32_t driven; /* whether the host moves the inputs, or the FMU has no example motion */
    int32_t unused; /* fills the padding, so that every byte is defined */
} Memory;

typedef struct {
    uint64_t hash; /* hash of all bytes after it */
    char token[sizeof FMU_TOKEN]; /* a state is valid only for the FMU that saved it */
    Memory memory;
} Saved;

typedef struct {
    Memory memory;
    int exchange; /* whether the instance is for Model Exchange */
    char message[256];
    const casadi_real *argument[WORK_ARGUMENTS]; /* work memory of CasADi's functions */
    casadi_real *result[WORK_RESULTS];
    casadi_int integers[WORK_INTEGERS];
    casadi_real reals[WORK_REALS];
    double next[ROOM(N_STATES)];
    double outputs[ROOM(N_OUTPUTS)];
    double rates[ROOM(N_CONTINUOUS)];
    double indicators[ROOM(N_INDICATORS)];
    double direction[ROOM(N_KNOWNS + WITH_EXAMPLE)]; /* direction of states, inputs and parameters, or the total gradient */
    double gradient[ROOM(N_KNOWNS + WITH_EXAMPLE)]; /* gradient of one relation */
    double slope[ROOM(N_UNKNOWNS)]; /* derivatives of outputs, rates, indicators and states, or their weights */
} Fmu;

typedef int Model(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);

/* Result of an update of the discrete states, and the time of the next one. */
typedef struct {
    int states_changed;
    double next_s;
} Update;

/* Functions that return int return 1 on success, else 0 with a message. fmu_step also returns
 * DISCARDED if a smaller step may succeed. */
enum { DISCARDED = 2 };

int fmu_refuse(Fmu *fmu, const char *format, ...);
int fmu_not_offered(Fmu *fmu, const char *call);
int fmu_allow(Fmu *fmu, const char *call, int legal);

/* Inner functions of the core. */
void fmu_evaluate(Fmu *fmu, Model *model, const double *x, double h, double *out);
void fmu_advance(Fmu *fmu, Model *model, double h);
void fmu_advance_step(Fmu *fmu, double step_s);
int fmu_all_finite(const double *value, size_t count);
int fmu_refresh(Fmu *fmu);
int fmu_refresh_rates(Fmu *fmu);
int fmu_refresh_indicators(Fmu *fmu);
int fmu_check_time(Fmu *fmu, double time_s, const char *what);
int fmu_check_value(Fmu *fmu, const Variable *variable, double value);

void fmu_follow_example(Fmu *fmu, double time_s);
void fmu_end_example(Fmu *fmu, const uint32_t reference[], size_t count);

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

/* Model Exchange. */
int fmu_enter_event_mode(Fmu *fmu);
int fmu_update(Fmu *fmu, Update *update);
int fmu_enter_continuous_time(Fmu *fmu);
int fmu_complete_step(Fmu *fmu);
int fmu_set_time(Fmu *fmu, double time_s);
int fmu_set_states(Fmu *fmu, const double state[], size_t count);
int fmu_get_states(Fmu *fmu, double state[], size_t count);
int fmu_get_rates(Fmu *fmu, double rate[], size_t count);
int fmu_get_indicators(Fmu *fmu, double indicator[], size_t count);
int fmu_get_nominals(Fmu *fmu, double nominal[], size_t count);

/* Derivatives of the unknowns along a direction of the knowns, and of a weighted sum of the
 * unknowns by each known. */
int fmu_forward(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[]);
int fmu_reverse(Fmu *fmu, const uint32_t unknown[], size_t unknowns, const uint32_t known[],
                size_t knowns, const double seed[], double sensitivity[]);

int fmu_save(Fmu *fmu, Saved **saved);
int fmu_restore(Fmu *fmu, const Saved *saved);
void fmu_free_saved(void **saved);
int fmu_serialize(Fmu *fmu, const Saved *saved, void *bytes, size_t size);
int fmu_deserialize(Fmu *fmu, const void *bytes, size_t size, Saved **saved);

#endif
