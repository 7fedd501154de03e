/* Core of an FMU, independent of the FMI version: see fmu_core.h. */
#include "fmu_core.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_STEP_S (1e6 * MAX_SUBSTEP_S)

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
    case EVENT: return "event mode";
    case CONTINUOUS: return "continuous-time mode";
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

void fmu_evaluate(Fmu *fmu, Model *model, const double *x, double h, double *out)
{
    const double *first[] = {x, fmu->memory.value + FIRST_INPUT,
                             fmu->memory.value + FIRST_PARAMETER, &h};
    /* (x, u, p, h); the initial state has no x. CasADi uses the entries behind as work memory. */
    memcpy(fmu->argument, x ? first : first + 1, (x ? 4 : 2) * sizeof *first);
    fmu->result[0] = out;
    model(fmu->argument, fmu->result, fmu->integers, fmu->reals, 0);
}

void fmu_advance(Fmu *fmu, Model *model, double h)
{
    fmu_evaluate(fmu, model, fmu->memory.state, h, fmu->next);
    memcpy(fmu->memory.state, fmu->next, sizeof fmu->next);
}

/* One step as the model defines it: samples at its begin, integration, samples at its end. */
void fmu_advance_step(Fmu *fmu, double step_s)
{
    double count = MAX(1.0, ceil(step_s / MAX_SUBSTEP_S - 1e-9));
    fmu_advance(fmu, model_begin, step_s);
    for (double i = 0.0; i < count; i++)
        fmu_advance(fmu, model_flow, step_s / count);
    fmu_advance(fmu, model_finish, step_s);
}

int fmu_all_finite(const double *value, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(value[i]))
            return 0;
    return 1;
}

/* Compute the outputs, and before the first step the state, from inputs and parameters. They are
 * stored only if all are finite, so the memory never holds other numbers. In Model Exchange the
 * sampled outputs keep their values between two samples. */
int fmu_refresh(Fmu *fmu)
{
    Memory *memory = &fmu->memory;
    const double *state = memory->state;
    int starting = memory->mode & (INSTANTIATED | INITIALIZING);
    if (!(memory->stale & STALE_OUTPUTS))
        return 1;
    if (starting) {
        fmu_evaluate(fmu, model_initial, NULL, 0.0, fmu->next);
        state = fmu->next;
    }
    fmu_evaluate(fmu, model_output, state, 0.0, fmu->outputs);
    if (!fmu_all_finite(state, N_STATES) || !fmu_all_finite(memory->value, FIRST_OUTPUT) ||
        !fmu_all_finite(fmu->outputs, N_OUTPUTS))
        return fmu_refuse(fmu, "The outputs are not finite numbers with these inputs and "
                               "parameters.");
    for (size_t i = 0; i < N_OUTPUTS; i++)
        if (starting || !fmu->exchange || !VARIABLES[FIRST_OUTPUT + i].sampled)
            memory->value[FIRST_OUTPUT + i] = fmu->outputs[i];
    if (starting)
        memcpy(memory->state, fmu->next, sizeof fmu->next);
    memory->stale &= ~STALE_OUTPUTS;
    return 1;
}

static int refresh_by(Fmu *fmu, Model *model, int stale, double *result, size_t count)
{
    if ((fmu->memory.mode & (INSTANTIATED | INITIALIZING)) && !fmu_refresh(fmu))
        return 0;
    if (!(fmu->memory.stale & stale))
        return 1;
    fmu_evaluate(fmu, model, fmu->memory.state, 0.0, result);
    if (!fmu_all_finite(result, count)) {
        fmu_refuse(fmu, "The derivatives are not finite numbers at this time: take a smaller "
                        "step.");
        return DISCARDED;
    }
    fmu->memory.stale &= ~stale;
    return 1;
}

/* The derivatives of the continuous states; DISCARDED where they are not finite numbers. */
int fmu_refresh_rates(Fmu *fmu)
{
    return refresh_by(fmu, model_rate, STALE_RATES, fmu->rates, N_CONTINUOUS);
}

int fmu_refresh_indicators(Fmu *fmu)
{
    return refresh_by(fmu, model_indicators, STALE_INDICATORS, fmu->indicators, N_INDICATORS);
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

int fmu_check_value(Fmu *fmu, const Variable *variable, double value)
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
    if (fmu->memory.mode == CONTINUOUS && variable->causality == PARAMETER)
        return fmu_refuse(fmu, "%s can change at events only: enter the event mode.",
                          variable->name);
    return fmu_check_value(fmu, variable, value);
}

int fmu_set_float64(Fmu *fmu, const uint32_t reference[], size_t count, const double value[])
{
    if (!check_type(fmu, reference, count, FLOAT64))
        return 0;
    for (size_t i = 0; i < count; i++)
        if (!check_set(fmu, &VARIABLES[reference[i]], value[i]))
            return 0;
    fmu_end_example(fmu, reference, count);
    for (size_t i = 0; i < count; i++)
        fmu->memory.value[reference[i]] = value[i];
    fmu->memory.stale = STALE;
    return 1;
}

/* Calculate what the value of a variable follows from; 1, 0 or DISCARDED. */
static int refresh_variable(Fmu *fmu, uint32_t reference)
{
    if (reference >= FIRST_INDICATOR)
        return fmu_refresh_indicators(fmu);
    if (reference >= FIRST_DERIVATIVE)
        return fmu_refresh_rates(fmu);
    if (reference >= FIRST_STATE && !(fmu->memory.mode & (INSTANTIATED | INITIALIZING)))
        return 1;
    return reference < FIRST_OUTPUT ? 1 : fmu_refresh(fmu);
}

static double value_of(const Fmu *fmu, uint32_t reference)
{
    if (reference >= FIRST_INDICATOR)
        return fmu->indicators[reference - FIRST_INDICATOR];
    if (reference >= FIRST_DERIVATIVE)
        return fmu->rates[reference - FIRST_DERIVATIVE];
    if (reference >= FIRST_STATE)
        return fmu->memory.state[reference - FIRST_STATE];
    return fmu->memory.value[reference];
}

int fmu_get_float64(Fmu *fmu, const uint32_t reference[], size_t count, double value[])
{
    if (!check_type(fmu, reference, count, FLOAT64))
        return 0;
    for (size_t i = 0; i < count; i++) {
        int ok = refresh_variable(fmu, reference[i]);
        if (ok != 1)
            return ok;
    }
    for (size_t i = 0; i < count; i++)
        value[i] = value_of(fmu, reference[i]);
    return 1;
}

int fmu_check_booleans(Fmu *fmu, const uint32_t reference[], size_t count)
{
    return check_type(fmu, reference, count, BOOLEAN);
}

int fmu_get_boolean(Fmu *fmu, uint32_t reference, int *truth)
{
    if (reference >= FIRST_OUTPUT && !fmu_refresh(fmu))
        return 0;
    *truth = fmu->memory.value[reference] > 0.5;
    return 1;
}

/* ---- Life cycle of an instance ------------------------------------------------------------- */

void fmu_reset(Fmu *fmu)
{
    memset(&fmu->memory, 0, sizeof fmu->memory);
    for (size_t i = 0; i < FIRST_STATE; i++)
        fmu->memory.value[i] = VARIABLES[i].start;
    fmu->memory.stop_s = INFINITY;
    fmu->memory.mode = INSTANTIATED;
    fmu->memory.driven = !WITH_EXAMPLE;
    fmu->memory.stale = STALE;
}

int fmu_check_token(Fmu *fmu, const char *token, const char *what)
{
    if (token && strcmp(token, FMU_TOKEN) == 0)
        return 1;
    return fmu_refuse(fmu, "The %s is of another FMU.", what);
}

int fmu_check_time(Fmu *fmu, double time_s, const char *what)
{
    return fabs(time_s) <= LATEST_S ||
           fmu_refuse(fmu, "The %s of %g s is not a number within %g s of zero.", what, time_s,
                      LATEST_S);
}

int fmu_start_at(Fmu *fmu, double start_s, int stop_defined, double stop_s)
{
    if (!fmu_check_time(fmu, start_s, "start time"))
        return 0;
    if (stop_defined && !(stop_s >= start_s))
        return fmu_refuse(fmu, "The stop time of %.9g s is before the start time of %.9g s.",
                          stop_s, start_s);
    fmu->memory.value[0] = fmu->memory.start_s = start_s;
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
    if (!fmu_refresh(fmu))
        return 0;
    fmu->memory.mode = fmu->exchange ? EVENT : STEPPING;
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
    if (time_s + step_s > memory->stop_s + 1e-6 * step_s + TIME_TOLERANCE * fabs(memory->stop_s))
        return fmu_refuse(fmu, "The step to %.9g s leads beyond the stop time of %.9g s.",
                          time_s + step_s, memory->stop_s);
    fmu_follow_example(fmu, SAMPLED ? time_s + step_s : time_s); /* sampled at the end */
    fmu_advance_step(fmu, step_s);
    memory->value[0] = time_s + step_s;
    memory->stale = STALE;
    if (fmu_refresh(fmu))
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
