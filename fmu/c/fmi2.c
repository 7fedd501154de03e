/* FMI 2.0 for Co-Simulation on top of fmu_core.c.
 *
 * Each call names the states in which it is legal (FMI 2.0, section 4.2.4). What this unit does
 * not offer is exported all the same, because importers look every function up: see the end.
 */
#include "fmi2Functions.h"

#include <stdlib.h>
#include <string.h>

#include "fmu_core.h"

typedef struct {
    Unit unit; /* first, so that a pointer to one is a pointer to the other */
    fmi2CallbackFunctions callbacks;
    char name[64];
} Instance;

/* Errors are told whether debug logging is on or not. */
static fmi2Status done(Instance *self, int well)
{
    if (well)
        return fmi2OK;
    if (self->callbacks.logger)
        self->callbacks.logger(self->callbacks.componentEnvironment, self->name, fmi2Error,
                               "logStatusError", "%s", self->unit.message);
    return fmi2Error;
}

#define ENTER(MODES)                                                                      \
    Instance *self = c;                                                                   \
    if (!self)                                                                            \
        return fmi2Error;                                                                 \
    if (!unit_allow(&self->unit, __func__, MODES))                                        \
        return done(self, 0);                                                             \
    Unit *unit = &self->unit

/* ---- Creation and destruction -------------------------------------------------------------- */

const char *fmi2GetTypesPlatform(void) { return fmi2TypesPlatform; }

const char *fmi2GetVersion(void) { return fmi2Version; }

fmi2Status fmi2SetDebugLogging(fmi2Component c, fmi2Boolean loggingOn, size_t nCategories,
                               const fmi2String categories[])
{
    ENTER(ANY_STATE);
    for (size_t i = 0; i < nCategories; i++)
        if (!categories[i] || strcmp(categories[i], "logStatusError") != 0)
            return done(self, unit_refuse(unit, "The only log category is logStatusError."));
    return fmi2OK;
}

fmi2Component fmi2Instantiate(fmi2String instanceName, fmi2Type fmuType, fmi2String fmuGUID,
                              fmi2String fmuResourceLocation,
                              const fmi2CallbackFunctions *functions, fmi2Boolean visible,
                              fmi2Boolean loggingOn)
{
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    if (functions)
        self->callbacks = *functions;
    if (instanceName)
        strncpy(self->name, instanceName, sizeof self->name - 1);
    unit_reset(&self->unit);
    if (fmuType == fmi2CoSimulation && fmuGUID && strcmp(fmuGUID, UNIT_TOKEN) == 0)
        return self;
    unit_refuse(&self->unit, fmuType == fmi2CoSimulation ? "The GUID is of another unit."
                                                         : "The unit is for co-simulation only.");
    done(self, 0);
    free(self);
    return NULL;
}

void fmi2FreeInstance(fmi2Component c) { free(c); }

/* ---- Initialization, steps, end ------------------------------------------------------------ */

fmi2Status fmi2SetupExperiment(fmi2Component c, fmi2Boolean toleranceDefined, fmi2Real tolerance,
                               fmi2Real startTime, fmi2Boolean stopTimeDefined, fmi2Real stopTime)
{
    ENTER(INSTANTIATED);
    return done(self, unit_start_at(unit, startTime));
}

fmi2Status fmi2EnterInitializationMode(fmi2Component c)
{
    ENTER(INSTANTIATED);
    unit->memory.mode = INITIALIZING;
    return fmi2OK;
}

fmi2Status fmi2ExitInitializationMode(fmi2Component c)
{
    ENTER(INITIALIZING);
    return done(self, unit_exit_initialization(unit));
}

fmi2Status fmi2DoStep(fmi2Component c, fmi2Real currentCommunicationPoint,
                      fmi2Real communicationStepSize, fmi2Boolean noSetFMUStatePriorToCurrentPoint)
{
    ENTER(STEPPING);
    return done(self, unit_step(unit, currentCommunicationPoint, communicationStepSize));
}

fmi2Status fmi2Terminate(fmi2Component c)
{
    ENTER(STEPPING);
    unit->memory.mode = TERMINATED;
    return fmi2OK;
}

fmi2Status fmi2Reset(fmi2Component c)
{
    ENTER(ANY_STATE);
    unit_reset(unit);
    return fmi2OK;
}

fmi2Status fmi2GetRealStatus(fmi2Component c, const fmi2StatusKind s, fmi2Real *value)
{
    ENTER(STEPPING | TERMINATED);
    if (s != fmi2LastSuccessfulTime)
        return done(self, unit_refuse(unit, "The only real status is the last successful time."));
    *value = unit->memory.value[0];
    return fmi2OK;
}

fmi2Status fmi2GetBooleanStatus(fmi2Component c, const fmi2StatusKind s, fmi2Boolean *value)
{
    ENTER(STEPPING | TERMINATED);
    if (s != fmi2Terminated)
        return done(self, unit_refuse(unit, "The only Boolean status is 'terminated'."));
    *value = unit->memory.mode == TERMINATED;
    return fmi2OK;
}

/* ---- Variables ----------------------------------------------------------------------------- */

fmi2Status fmi2GetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       fmi2Real value[])
{
    ENTER(INITIALIZING | STEPPING | TERMINATED);
    return done(self, unit_check_type(unit, vr, nvr, FLOAT64) && unit_get(unit, vr, nvr, value));
}

fmi2Status fmi2SetReal(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                       const fmi2Real value[])
{
    ENTER(INSTANTIATED | INITIALIZING | STEPPING);
    return done(self, unit_check_type(unit, vr, nvr, FLOAT64) && unit_set(unit, vr, nvr, value));
}

fmi2Status fmi2GetBoolean(fmi2Component c, const fmi2ValueReference vr[], size_t nvr,
                          fmi2Boolean value[])
{
    ENTER(INITIALIZING | STEPPING | TERMINATED);
    int well = unit_check_type(unit, vr, nvr, BOOLEAN);
    for (size_t i = 0; well && i < nvr; i++) {
        double truth = 0.0;
        well = unit_get(unit, vr + i, 1, &truth);
        value[i] = truth > 0.5;
    }
    return done(self, well);
}

/* ---- Saved states -------------------------------------------------------------------------- */

fmi2Status fmi2GetFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    ENTER(ANY_STATE);
    return done(self, unit_save(unit, (Saved **)FMUstate));
}

fmi2Status fmi2SetFMUstate(fmi2Component c, fmi2FMUstate FMUstate)
{
    ENTER(ANY_STATE);
    return done(self, unit_restore(unit, FMUstate));
}

fmi2Status fmi2FreeFMUstate(fmi2Component c, fmi2FMUstate *FMUstate)
{
    ENTER(ANY_STATE);
    (void)unit;
    if (FMUstate) {
        free(*FMUstate);
        *FMUstate = NULL;
    }
    return fmi2OK;
}

fmi2Status fmi2SerializedFMUstateSize(fmi2Component c, fmi2FMUstate FMUstate, size_t *size)
{
    ENTER(ANY_STATE);
    (void)unit;
    *size = sizeof(Saved);
    return fmi2OK;
}

fmi2Status fmi2SerializeFMUstate(fmi2Component c, fmi2FMUstate FMUstate,
                                 fmi2Byte serializedState[], size_t size)
{
    ENTER(ANY_STATE);
    if (!unit_check_saved(unit, FMUstate, size))
        return done(self, 0);
    memcpy(serializedState, FMUstate, size);
    return fmi2OK;
}

fmi2Status fmi2DeSerializeFMUstate(fmi2Component c, const fmi2Byte serializedState[], size_t size,
                                   fmi2FMUstate *FMUstate)
{
    ENTER(ANY_STATE);
    if (!unit_check_saved(unit, serializedState, size) || !unit_save(unit, (Saved **)FMUstate))
        return done(self, 0);
    memcpy(*FMUstate, serializedState, size);
    return fmi2OK;
}

/* ---- Not offered --------------------------------------------------------------------------- */

static fmi2Status not_offered(fmi2Component c, const char *call)
{
    Instance *self = c;
    return self ? done(self, unit_refuse(&self->unit, "%s is not offered by this unit.", call))
                : fmi2Error;
}

#define CALL(name, ...)                                                                   \
    fmi2Status name(fmi2Component c, __VA_ARGS__) { return not_offered(c, #name); }
#define BARE_CALL(name)                                                                   \
    fmi2Status name(fmi2Component c) { return not_offered(c, #name); }
#define REFERENCES const fmi2ValueReference vr[], size_t n
/* The unit has no variables of the type; asking for none of them is no mistake. */
#define TYPED(name, ...)                                                                  \
    fmi2Status name(fmi2Component c, REFERENCES, __VA_ARGS__)                             \
    {                                                                                     \
        return n && c ? not_offered(c, #name) : fmi2OK;                                   \
    }

TYPED(fmi2GetInteger, fmi2Integer value[])
TYPED(fmi2SetInteger, const fmi2Integer value[])
TYPED(fmi2GetString, fmi2String value[])
TYPED(fmi2SetString, const fmi2String value[])
TYPED(fmi2SetBoolean, const fmi2Boolean value[])

CALL(fmi2GetDirectionalDerivative, REFERENCES, const fmi2ValueReference known[], size_t nKnown,
     const fmi2Real dvKnown[], fmi2Real dvUnknown[])
CALL(fmi2SetRealInputDerivatives, REFERENCES, const fmi2Integer order[], const fmi2Real value[])
CALL(fmi2GetRealOutputDerivatives, REFERENCES, const fmi2Integer order[], fmi2Real value[])
BARE_CALL(fmi2CancelStep)
CALL(fmi2GetStatus, const fmi2StatusKind s, fmi2Status *value)
CALL(fmi2GetIntegerStatus, const fmi2StatusKind s, fmi2Integer *value)
CALL(fmi2GetStringStatus, const fmi2StatusKind s, fmi2String *value)

BARE_CALL(fmi2EnterEventMode)
CALL(fmi2NewDiscreteStates, fmi2EventInfo *info)
BARE_CALL(fmi2EnterContinuousTimeMode)
CALL(fmi2CompletedIntegratorStep, fmi2Boolean noSetState, fmi2Boolean *enterEventMode,
     fmi2Boolean *terminate)
CALL(fmi2SetTime, fmi2Real time)
CALL(fmi2SetContinuousStates, const fmi2Real x[], size_t nx)
CALL(fmi2GetDerivatives, fmi2Real derivatives[], size_t nx)
CALL(fmi2GetEventIndicators, fmi2Real indicators[], size_t ni)
CALL(fmi2GetContinuousStates, fmi2Real x[], size_t nx)
CALL(fmi2GetNominalsOfContinuousStates, fmi2Real nominals[], size_t nx)
