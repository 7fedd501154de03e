/* The core of a unit, free of FMI: see fmu_core.h. */
#include "fmu_core.h"

#include <math.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define LONGEST_STEP_S (1e6 * MAX_SUBSTEP_S)

typedef int Model(const casadi_real **, casadi_real **, casadi_int *, casadi_real *, int);

/* ---- Messages ------------------------------------------------------------------------------ */

int unit_refuse(Unit *unit, const char *format, ...)
{
    va_list arguments;
    va_start(arguments, format);
    vsnprintf(unit->message, sizeof unit->message, format, arguments);
    va_end(arguments);
    return 0;
}

static const char *mode_name(int mode)
{
    switch (mode) {
    case INSTANTIATED: return "instantiated";
    case INITIALIZING: return "initialization mode";
    case STEPPING: return "step mode";
    default: return "terminated";
    }
}

int unit_allow(Unit *unit, const char *call, int modes)
{
    if (unit->memory.mode & modes)
        return 1;
    return unit_refuse(unit, "%s is not allowed in the state '%s'.", call,
                       mode_name(unit->memory.mode));
}

/* ---- The model's functions ----------------------------------------------------------------- */

static void evaluate(Unit *unit, Model *model, const double *x, double h, double *out)
{
    const double *first[] = {x, unit->memory.value + FIRST_INPUT,
                             unit->memory.value + FIRST_PARAMETER, &h};
    /* (x, u, p, h); the initial state has no x in front. CasADi uses what follows as scratch. */
    memcpy(unit->argument, x ? first : first + 1, (x ? 4 : 2) * sizeof *first);
    unit->result[0] = out;
    model(unit->argument, unit->result, unit->integers, unit->reals, 0);
}

static void advance(Unit *unit, Model *model, double h)
{
    evaluate(unit, model, unit->memory.state, h, unit->next);
    memcpy(unit->memory.state, unit->next, sizeof unit->next);
}

static int all_finite(const double *value, size_t count)
{
    for (size_t i = 0; i < count; i++)
        if (!isfinite(value[i]))
            return 0;
    return 1;
}

/* Let the outputs, and before the first step the state, follow inputs and parameters. */
static int refresh(Unit *unit)
{
    Memory *memory = &unit->memory;
    if (!memory->stale)
        return 1;
    if (memory->mode & (INSTANTIATED | INITIALIZING))
        evaluate(unit, model_initial, NULL, 0.0, memory->state);
    evaluate(unit, model_output, memory->state, 0.0, memory->value + FIRST_OUTPUT);
    memory->stale = 0;
    if (all_finite(memory->state, N_STATES) && all_finite(memory->value, N_VARIABLES))
        return 1;
    memory->stale = 1;
    return unit_refuse(unit, "The outputs are not finite numbers with these inputs and parameters.");
}

/* ---- Variables ----------------------------------------------------------------------------- */

int unit_check_type(Unit *unit, const uint32_t reference[], size_t count, Type type)
{
    for (size_t i = 0; i < count; i++) {
        if (reference[i] >= N_VARIABLES)
            return unit_refuse(unit, "There is no variable with value reference %u.",
                               (unsigned)reference[i]);
        if (VARIABLES[reference[i]].type != type)
            return unit_refuse(unit, "%s is not of the type that the call is for.",
                               VARIABLES[reference[i]].name);
    }
    return 1;
}

static int settable(Unit *unit, const Variable *variable, double value)
{
    if (variable->causality != INPUT && variable->causality != PARAMETER)
        return unit_refuse(unit, "%s cannot be set: it is calculated.", variable->name);
    if (!isfinite(value))
        return unit_refuse(unit, "%s cannot be set to a value that is not a finite number.",
                           variable->name);
    if (variable->causality == PARAMETER &&
        (value < variable->minimum || value > variable->maximum))
        return unit_refuse(unit, "%s = %g lies outside %g to %g.", variable->name, value,
                           variable->minimum, variable->maximum);
    return 1;
}

int unit_set(Unit *unit, const uint32_t reference[], size_t count, const double value[])
{
    for (size_t i = 0; i < count; i++)
        if (!settable(unit, &VARIABLES[reference[i]], value[i]))
            return 0;
    for (size_t i = 0; i < count; i++)
        unit->memory.value[reference[i]] = value[i];
    unit->memory.stale = 1;
    return 1;
}

int unit_get(Unit *unit, const uint32_t reference[], size_t count, double value[])
{
    for (size_t i = 0; i < count; i++)
        if (reference[i] >= FIRST_OUTPUT && !refresh(unit))
            return 0;
    for (size_t i = 0; i < count; i++)
        value[i] = unit->memory.value[reference[i]];
    return 1;
}

/* ---- The life of an instance --------------------------------------------------------------- */

void unit_reset(Unit *unit)
{
    memset(&unit->memory, 0, sizeof unit->memory);
    for (size_t i = 0; i < N_VARIABLES; i++)
        unit->memory.value[i] = VARIABLES[i].start;
    unit->memory.mode = INSTANTIATED;
    unit->memory.stale = 1;
}

int unit_start_at(Unit *unit, double start_s)
{
    if (!isfinite(start_s))
        return unit_refuse(unit, "The start time is not a finite number.");
    unit->memory.value[0] = start_s;
    return 1;
}

int unit_exit_initialization(Unit *unit)
{
    if (!refresh(unit))
        return 0;
    unit->memory.mode = STEPPING;
    return 1;
}

int unit_step(Unit *unit, double time_s, double step_s)
{
    Memory before = unit->memory;
    double now_s = before.value[0];
    if (!(step_s > 0.0 && step_s <= LONGEST_STEP_S))
        return unit_refuse(unit, "The step of %g s is not within 0 to %g s.", step_s,
                           LONGEST_STEP_S);
    if (!(fabs(time_s - now_s) <= 1e-6 * step_s + 1e-12 * fabs(now_s)))
        return unit_refuse(unit, "The step starts at %.9g s but the unit stands at %.9g s.",
                           time_s, now_s);
    double count = MAX(1.0, ceil(step_s / MAX_SUBSTEP_S - 1e-9));
    advance(unit, model_begin, step_s);
    for (double i = 0.0; i < count; i++)
        advance(unit, model_flow, step_s / count);
    advance(unit, model_finish, step_s);
    unit->memory.value[0] = time_s + step_s;
    unit->memory.stale = 1;
    if (refresh(unit))
        return 1;
    unit->memory = before;
    return unit_refuse(unit, "The step from %.9g s gave values that are not finite numbers.",
                       now_s);
}

/* ---- Saved states -------------------------------------------------------------------------- */

int unit_save(Unit *unit, Saved **saved)
{
    if (!*saved)
        *saved = calloc(1, sizeof **saved);
    if (!*saved)
        return unit_refuse(unit, "There is no memory left for a saved state.");
    memcpy((*saved)->token, UNIT_TOKEN, sizeof UNIT_TOKEN);
    (*saved)->memory = unit->memory;
    return 1;
}

int unit_check_saved(Unit *unit, const void *bytes, size_t size)
{
    Saved saved;
    if (!bytes)
        return unit_refuse(unit, "There is no saved state.");
    if (size != sizeof saved)
        return unit_refuse(unit, "A saved state of this unit has %u bytes, not %u.",
                           (unsigned)sizeof saved, (unsigned)size);
    memcpy(&saved, bytes, sizeof saved); /* the importer's bytes may lie unaligned */
    int mode = saved.memory.mode;
    if (memcmp(saved.token, UNIT_TOKEN, sizeof UNIT_TOKEN) != 0 ||
        !(mode == INSTANTIATED || mode == INITIALIZING || mode == STEPPING || mode == TERMINATED))
        return unit_refuse(unit, "The saved state comes from another unit.");
    return 1;
}

int unit_restore(Unit *unit, const Saved *saved)
{
    if (!unit_check_saved(unit, saved, sizeof *saved))
        return 0;
    unit->memory = saved->memory;
    return 1;
}
