/* Core of an FMU, independent of the FMI version: see fmu_core.h. */
#include "fmu_core.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_STEP_S (1e6 * MAX_SUBSTEP_S)
/* A host that adds its steps up passes the stop time by rounding; FMPy compares times to 1e-9. */
#define STOP_TOLERANCE 1e-9

typedef int Model(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);

/* ---- Messages ------------------------------------------------------------------------------ */

int fmu_refuse(Fmu *fmu, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(fmu->message, sizeof fmu->message, format, arguments);
    va_end(arguments);
    return 0;
}

int fmu_not_offered(Fmu *fmu, const char *call)
{
    return fmu_refuse(fmu, "%s is not offered by this FMU.", call);
}

int fmu_check_log_categories(Fmu *fmu, const char *const category[], size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!category[i] || strcmp(category[i], "logStatusError") != 0)
            return fmu_refuse(fmu, "The only log category is logStatusError.");
    return 1;
}

/* ---- States -------------------------------------------------------------------------------- */

static const char *mode_name(int mode)
{
    switch (mode) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZING: return "initialization mode";
    case STEPPING: return "step mode";
    default: return "terminated";
    }
}

int fmu_allow(Fmu *fmu, const char *call, int legal)
{
    if (fmu->memory.mode & legal)
        return 1;
    return fmu_refuse(fmu, "%s is not allowed in the state '%s'.", call,
                      mode_name(fmu->memory.mode));
}

/* ---- Functions of the model ---------------------------------------------------------------- */

static void evaluate(Fmu *fmu, Model *model, const double *x, double h, double *out)
{
    const double *first[] = {x, fmu->memory.value + FIRST_INPUT,
                             fmu->memory.value + FIRST_PARAMETER, &h};
    /* (x, u, p, h); the initial state has no x. CasADi uses the entries behind as work memory. */
    memcpy(fmu->argument, x ? first : first + 1, (x ? 4 : 2) * sizeof *first);
    fmu->result[0] = out;
    model(fmu->argument, fmu->result, fmu->integers, fmu->reals, 0);
}

static void advance(Fmu *fmu, Model *model, double h)
{
    evaluate(fmu, model, fmu->memory.state, h, fmu->next);
    memcpy(fmu->memory.state, fmu->next, sizeof fmu->next);
}

static int all_finite(const double *value, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(value[i]))
            return 0;
    return 1;
}

/* Compute the outputs, and before the first step the state, from inputs and parameters. They are
 * taken only where all are finite numbers, so that the memory never holds others. */
static int refresh(Fmu *fmu)
{
    Memory *memory = &fmu->memory;
    const double *state = memory->state;
    double *outputs = fmu->outputs;
    if (!memory->stale)
        return 1;
    if (memory->mode & (INSTANTIATED | INITIALIZING)) {
        evaluate(fmu, model_initial, NULL, 0.0, fmu->next);
        state = fmu->next;
    }
    evaluate(fmu, model_output, state, 0.0, outputs);
    if (!all_finite(state, N_STATES) || !all_finite(memory->value, FIRST_OUTPUT) ||
        !all_finite(outputs, N_OUTPUTS))
        return fmu_refuse(fmu, "The outputs are not finite numbers with these inputs and "
                               "parameters.");
    memcpy(memory->value + FIRST_OUTPUT, outputs, N_OUTPUTS * sizeof *outputs);
    if (state == fmu->next)
        memcpy(memory->state, fmu->next, sizeof fmu->next);
    memory->stale = 0;
    return 1;
}

/* ---- Variables ----------------------------------------------------------------------------- */

static int check_type(Fmu *fmu, const uint32_t reference[], size_t count, Type type)
{
    for (size_t i = 0; i < count; i++) {
        if (reference[i] >= N_VARIABLES)
            return fmu_refuse(fmu, "There is no variable with value reference %u.",
                              (unsigned)reference[i]);
        if (VARIABLES[reference[i]].type != type)
            return fmu_refuse(fmu, "%s is not of the type of this call.",
                              VARIABLES[reference[i]].name);
    }
    return 1;
}

static int is_settable(const Variable *variable)
{
    return variable->causality == INPUT || variable->causality == PARAMETER;
}

static int check_value(Fmu *fmu, const Variable *variable, double value)
{
    if (!isfinite(value))
        return fmu_refuse(fmu, "%s cannot have a value that is not a finite number.",
                          variable->name);
    if (is_settable(variable) && (value < variable->minimum || value > variable->maximum))
        return fmu_refuse(fmu, "%s = %g lies outside %g to %g.", variable->name, value,
                          variable->minimum, variable->maximum);
    return 1;
}

static int check_set(Fmu *fmu, const Variable *variable, double value)
{
    if (!is_settable(variable))
        return fmu_refuse(fmu, "%s cannot be set: it is calculated.", variable->name);
    return check_value(fmu, variable, value);
}

int fmu_set_float64(Fmu *fmu, const uint32_t reference[], size_t count, const double value[])
{
    if (!check_type(fmu, reference, count, FLOAT64))
        return 0;
    for (size_t i = 0; i < count; i++)
        if (!check_set(fmu, &VARIABLES[reference[i]], value[i]))
            return 0;
    for (size_t i = 0; i < count; i++)
        fmu->memory.value[reference[i]] = value[i];
    fmu->memory.stale = 1;
    return 1;
}

int fmu_get_float64(Fmu *fmu, const uint32_t reference[], size_t count, double value[])
{
    if (!check_type(fmu, reference, count, FLOAT64))
        return 0;
    for (size_t i = 0; i < count; i++)
        if (reference[i] >= FIRST_OUTPUT && !refresh(fmu))
            return 0;
    for (size_t i = 0; i < count; i++)
        value[i] = fmu->memory.value[reference[i]];
    return 1;
}

int fmu_check_booleans(Fmu *fmu, const uint32_t reference[], size_t count)
{
    return check_type(fmu, reference, count, BOOLEAN);
}

int fmu_get_boolean(Fmu *fmu, uint32_t reference, int *truth)
{
    if (reference >= FIRST_OUTPUT && !refresh(fmu))
        return 0;
    *truth = fmu->memory.value[reference] > 0.5;
    return 1;
}

/* ---- Life cycle of an instance ------------------------------------------------------------- */

void fmu_reset(Fmu *fmu)
{
    memset(&fmu->memory, 0, sizeof fmu->memory);
    for (size_t i = 0; i < N_VARIABLES; i++)
        fmu->memory.value[i] = VARIABLES[i].start;
    fmu->memory.stop_s = INFINITY;
    fmu->memory.mode = INSTANTIATED;
    fmu->memory.stale = 1;
}

int fmu_check_token(Fmu *fmu, const char *token, const char *what)
{
    if (token && strcmp(token, FMU_TOKEN) == 0)
        return 1;
    return fmu_refuse(fmu, "The %s is of another FMU.", what);
}

int fmu_start_at(Fmu *fmu, double start_s, int stop_defined, double stop_s)
{
    if (!isfinite(start_s))
        return fmu_refuse(fmu, "The start time is not a finite number.");
    if (stop_defined && !(stop_s >= start_s))
        return fmu_refuse(fmu, "The stop time of %.9g s is before the start time of %.9g s.",
                          stop_s, start_s);
    fmu->memory.value[0] = start_s;
    fmu->memory.stop_s = stop_defined ? stop_s : INFINITY;
    return 1;
}

int fmu_enter_initialization(Fmu *fmu)
{
    fmu->memory.mode = INITIALIZING;
    return 1;
}

int fmu_exit_initialization(Fmu *fmu)
{
    if (!refresh(fmu))
        return 0;
    fmu->memory.mode = STEPPING;
    return 1;
}

int fmu_step(Fmu *fmu, double time_s, double step_s)
{
    Memory *memory = &fmu->memory, before = *memory;
    double now_s = before.value[0];
    if (!(step_s > 0.0 && step_s <= LONGEST_STEP_S))
        return fmu_refuse(fmu, "The step of %g s is not within 0 to %g s.", step_s,
                          LONGEST_STEP_S);
    if (!(fabs(time_s - now_s) <= 1e-6 * step_s + 1e-12 * fabs(now_s)))
        return fmu_refuse(fmu, "The step starts at %.9g s but the FMU stands at %.9g s.", time_s,
                          now_s);
    if (time_s + step_s > memory->stop_s + 1e-6 * step_s + STOP_TOLERANCE * fabs(memory->stop_s))
        return fmu_refuse(fmu, "The step to %.9g s leads beyond the stop time of %.9g s.",
                          time_s + step_s, memory->stop_s);
    double count = MAX(1.0, ceil(step_s / MAX_SUBSTEP_S - 1e-9));
    advance(fmu, model_begin, step_s);
    for (double i = 0.0; i < count; i++)
        advance(fmu, model_flow, step_s / count);
    advance(fmu, model_finish, step_s);
    memory->value[0] = time_s + step_s;
    memory->stale = 1;
    if (refresh(fmu))
        return 1;
    *memory = before;
    fmu_refuse(fmu, "The step from %.9g s gave values that are not finite numbers: take a smaller "
                    "step.", now_s);
    return DISCARDED;
}

int fmu_terminate(Fmu *fmu)
{
    fmu->memory.mode = TERMINATED;
    return 1;
}

/* ---- Saved states -------------------------------------------------------------------------- */

/* FNV-1a in 64 bits (Fowler, Noll and Vo): any single changed byte changes it. */
static uint64_t hash_of(const Saved *saved)
{
    const unsigned char *byte = (const unsigned char *)saved;
    uint64_t hash = UINT64_C(0xcbf29ce484222325);
    for (size_t i = sizeof saved->hash; i < sizeof *saved; i++)
        hash = (hash ^ byte[i]) * UINT64_C(0x100000001b3);
    return hash;
}

static int check_saved(Fmu *fmu, const void *bytes, size_t size)
{
    Saved saved;
    const Memory *memory = &saved.memory;
    if (!bytes)
        return fmu_refuse(fmu, "There is no saved state.");
    if (size != sizeof saved)
        return fmu_refuse(fmu, "A saved state of this FMU has %u bytes, not %u.",
                          (unsigned)sizeof saved, (unsigned)size);
    memcpy(&saved, bytes, sizeof saved); /* the importer's bytes may lie unaligned */
    int mode = memory->mode;
    if (memcmp(saved.token, FMU_TOKEN, sizeof FMU_TOKEN) != 0)
        return fmu_refuse(fmu, "The saved state comes from another FMU.");
    if (saved.hash != hash_of(&saved) || isnan(memory->stop_s) ||
        !(mode == INSTANTIATED || mode == INITIALIZING || mode == STEPPING || mode == TERMINATED))
        return fmu_refuse(fmu, "The saved state is damaged.");
    if (!all_finite(memory->state, N_STATES))
        return fmu_refuse(fmu, "The saved state holds values that are not finite numbers.");
    for (size_t i = 0; i < N_VARIABLES; i++)
        if (!check_value(fmu, &VARIABLES[i], memory->value[i]))
            return 0;
    return 1;
}

int fmu_save(Fmu *fmu, Saved **saved)
{
    if (!*saved)
        *saved = calloc(1, sizeof **saved);
    if (!*saved)
        return fmu_refuse(fmu, "There is no memory left for a saved state.");
    memcpy((*saved)->token, FMU_TOKEN, sizeof FMU_TOKEN);
    (*saved)->memory = fmu->memory;
    (*saved)->hash = hash_of(*saved);
    return 1;
}

int fmu_restore(Fmu *fmu, const Saved *saved)
{
    if (!check_saved(fmu, saved, sizeof *saved))
        return 0;
    fmu->memory = saved->memory;
    return 1;
}

void fmu_free_saved(void **saved)
{
    if (!saved)
        return;
    free(*saved);
    *saved = NULL;
}

int fmu_serialize(Fmu *fmu, const Saved *saved, void *bytes, size_t size)
{
    if (!check_saved(fmu, saved, size))
        return 0;
    memcpy(bytes, saved, size);
    return 1;
}

int fmu_deserialize(Fmu *fmu, const void *bytes, size_t size, Saved **saved)
{
    if (!check_saved(fmu, bytes, size) || !fmu_save(fmu, saved))
        return 0;
    memcpy(*saved, bytes, size);
    return 1;
}
