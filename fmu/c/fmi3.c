/* FMI 3.0 for Co-Simulation on top of fmu_core.c.
 *
 * Each call names the states in which it is legal (FMI 3.0, section 4.2). What this unit does not
 * offer is exported all the same, because importers look every function up: see the end.
 */
#include "fmi3Functions.h"

#include <stdlib.h>
#include <string.h>

#include "fmu_core.h"

typedef struct {
    Unit unit; /* first, so that a pointer to one is a pointer to the other */
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    fmi3Boolean logging;
} Instance;

static fmi3Status done(Instance *self, int well)
{
    if (well)
        return fmi3OK;
    if (self->logging && self->log)
        self->log(self->environment, fmi3Error, "logStatusError", self->unit.message);
    return fmi3Error;
}

#define ENTER(MODES)                                                                      \
    Instance *self = instance;                                                            \
    if (!self)                                                                            \
        return fmi3Error;                                                                 \
    if (!unit_allow(&self->unit, __func__, MODES))                                        \
        return done(self, 0);                                                             \
    Unit *unit = &self->unit

/* ---- Creation and destruction -------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    ENTER(ANY_STATE);
    for (size_t i = 0; i < nCategories; i++)
        if (!categories[i] || strcmp(categories[i], "logStatusError") != 0)
            return done(self, unit_refuse(unit, "The only log category is logStatusError."));
    self->logging = loggingOn;
    return fmi3OK;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate)
{
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->log = logMessage;
    self->environment = instanceEnvironment;
    self->logging = loggingOn;
    unit_reset(&self->unit);
    if (instantiationToken && strcmp(instantiationToken, UNIT_TOKEN) == 0 && !eventModeUsed)
        return self;
    unit_refuse(&self->unit, eventModeUsed ? "The unit has no event mode."
                                           : "The instantiation token is of another unit.");
    done(self, 0);
    free(self);
    return NULL;
}

fmi3Instance fmi3InstantiateModelExchange(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage)
{
    return NULL;
}

fmi3Instance fmi3InstantiateScheduledExecution(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3ClockUpdateCallback clockUpdate,
    fmi3LockPreemptionCallback lockPreemption, fmi3UnlockPreemptionCallback unlockPreemption)
{
    return NULL;
}

void fmi3FreeInstance(fmi3Instance instance) { free(instance); }

/* ---- Initialization, steps, end ------------------------------------------------------------ */

fmi3Status fmi3EnterInitializationMode(fmi3Instance instance, fmi3Boolean toleranceDefined,
                                       fmi3Float64 tolerance, fmi3Float64 startTime,
                                       fmi3Boolean stopTimeDefined, fmi3Float64 stopTime)
{
    ENTER(INSTANTIATED);
    if (!unit_start_at(unit, startTime))
        return done(self, 0);
    unit->memory.mode = INITIALIZING;
    return fmi3OK;
}

fmi3Status fmi3ExitInitializationMode(fmi3Instance instance)
{
    ENTER(INITIALIZING);
    return done(self, unit_exit_initialization(unit));
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    ENTER(STEPPING);
    int well = unit_step(unit, currentCommunicationPoint, communicationStepSize);
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = unit->memory.value[0];
    return done(self, well);
}

fmi3Status fmi3Terminate(fmi3Instance instance)
{
    ENTER(STEPPING);
    unit->memory.mode = TERMINATED;
    return fmi3OK;
}

fmi3Status fmi3Reset(fmi3Instance instance)
{
    ENTER(ANY_STATE);
    unit_reset(unit);
    return fmi3OK;
}

/* ---- Variables ----------------------------------------------------------------------------- */

static int matches(Unit *unit, const fmi3ValueReference reference[], size_t count, size_t values,
                   Type type)
{
    if (count != values)
        return unit_refuse(unit, "All variables are scalars: give one value for each.");
    return unit_check_type(unit, reference, count, type);
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    ENTER(ANY_STATE);
    return done(self, matches(unit, valueReferences, nValueReferences, nValues, FLOAT64) &&
                          unit_get(unit, valueReferences, nValues, values));
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues)
{
    ENTER(INSTANTIATED | INITIALIZING | STEPPING);
    return done(self, matches(unit, valueReferences, nValueReferences, nValues, FLOAT64) &&
                          unit_set(unit, valueReferences, nValues, values));
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Boolean values[], size_t nValues)
{
    ENTER(ANY_STATE);
    int well = matches(unit, valueReferences, nValueReferences, nValues, BOOLEAN);
    for (size_t i = 0; well && i < nValues; i++) {
        double value = 0.0;
        well = unit_get(unit, valueReferences + i, 1, &value);
        values[i] = value > 0.5;
    }
    return done(self, well);
}

/* ---- Saved states -------------------------------------------------------------------------- */

fmi3Status fmi3GetFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    ENTER(ANY_STATE);
    return done(self, unit_save(unit, (Saved **)FMUState));
}

fmi3Status fmi3SetFMUState(fmi3Instance instance, fmi3FMUState FMUState)
{
    ENTER(ANY_STATE);
    return done(self, unit_restore(unit, FMUState));
}

fmi3Status fmi3FreeFMUState(fmi3Instance instance, fmi3FMUState *FMUState)
{
    ENTER(ANY_STATE);
    (void)unit;
    if (FMUState) {
        free(*FMUState);
        *FMUState = NULL;
    }
    return fmi3OK;
}

fmi3Status fmi3SerializedFMUStateSize(fmi3Instance instance, fmi3FMUState FMUState, size_t *size)
{
    ENTER(ANY_STATE);
    (void)unit;
    *size = sizeof(Saved);
    return fmi3OK;
}

fmi3Status fmi3SerializeFMUState(fmi3Instance instance, fmi3FMUState FMUState,
                                 fmi3Byte serializedState[], size_t size)
{
    ENTER(ANY_STATE);
    if (!unit_check_saved(unit, FMUState, size))
        return done(self, 0);
    memcpy(serializedState, FMUState, size);
    return fmi3OK;
}

fmi3Status fmi3DeserializeFMUState(fmi3Instance instance, const fmi3Byte serializedState[],
                                   size_t size, fmi3FMUState *FMUState)
{
    ENTER(ANY_STATE);
    if (!unit_check_saved(unit, serializedState, size) || !unit_save(unit, (Saved **)FMUState))
        return done(self, 0);
    memcpy(*FMUState, serializedState, size);
    return fmi3OK;
}

/* ---- Not offered --------------------------------------------------------------------------- */

static fmi3Status not_offered(fmi3Instance instance, const char *call)
{
    Instance *self = instance;
    return self ? done(self, unit_refuse(&self->unit, "%s is not offered by this unit.", call))
                : fmi3Error;
}

#define CALL(name, ...)                                                                   \
    fmi3Status name(fmi3Instance instance, __VA_ARGS__) { return not_offered(instance, #name); }
#define BARE_CALL(name)                                                                   \
    fmi3Status name(fmi3Instance instance) { return not_offered(instance, #name); }
#define REFERENCES const fmi3ValueReference r[], size_t n
/* The unit has no variables of the type; asking for none of them is no mistake. */
#define TYPED(name, ...)                                                                  \
    fmi3Status name(fmi3Instance instance, REFERENCES, __VA_ARGS__)                       \
    {                                                                                     \
        return n && instance ? not_offered(instance, #name) : fmi3OK;                     \
    }
#define TYPE(T)                                                                           \
    TYPED(fmi3Get##T, fmi3##T values[], size_t nValues)                                   \
    TYPED(fmi3Set##T, const fmi3##T values[], size_t nValues)

TYPE(Float32) TYPE(Int8) TYPE(UInt8) TYPE(Int16) TYPE(UInt16) TYPE(Int32) TYPE(UInt32)
TYPE(Int64) TYPE(UInt64) TYPE(String)
TYPED(fmi3SetBoolean, const fmi3Boolean values[], size_t nValues)
TYPED(fmi3GetBinary, size_t sizes[], fmi3Binary values[], size_t nValues)
TYPED(fmi3SetBinary, const size_t sizes[], const fmi3Binary values[], size_t nValues)
TYPED(fmi3GetClock, fmi3Clock values[])
TYPED(fmi3SetClock, const fmi3Clock values[])

CALL(fmi3GetNumberOfVariableDependencies, fmi3ValueReference r, size_t *n)
CALL(fmi3GetVariableDependencies, fmi3ValueReference dependent, size_t elements[],
     fmi3ValueReference independents[], size_t elementsOfIndependents[],
     fmi3DependencyKind kinds[], size_t n)
CALL(fmi3GetDirectionalDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t nKnowns,
     const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
CALL(fmi3GetAdjointDerivative, REFERENCES, const fmi3ValueReference knowns[], size_t nKnowns,
     const fmi3Float64 seed[], size_t nSeed, fmi3Float64 sensitivity[], size_t nSensitivity)
CALL(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[],
     size_t nValues)

BARE_CALL(fmi3EnterEventMode)
BARE_CALL(fmi3EnterStepMode)
BARE_CALL(fmi3EnterConfigurationMode)
BARE_CALL(fmi3ExitConfigurationMode)
BARE_CALL(fmi3EvaluateDiscreteStates)
CALL(fmi3UpdateDiscreteStates, fmi3Boolean *needUpdate, fmi3Boolean *terminate,
     fmi3Boolean *nominalsChanged, fmi3Boolean *valuesChanged, fmi3Boolean *timeDefined,
     fmi3Float64 *time)

CALL(fmi3GetIntervalDecimal, REFERENCES, fmi3Float64 intervals[], fmi3IntervalQualifier kinds[])
CALL(fmi3GetIntervalFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[],
     fmi3IntervalQualifier kinds[])
CALL(fmi3GetShiftDecimal, REFERENCES, fmi3Float64 shifts[])
CALL(fmi3GetShiftFraction, REFERENCES, fmi3UInt64 counters[], fmi3UInt64 resolutions[])
CALL(fmi3SetIntervalDecimal, REFERENCES, const fmi3Float64 intervals[])
CALL(fmi3SetIntervalFraction, REFERENCES, const fmi3UInt64 counters[],
     const fmi3UInt64 resolutions[])
CALL(fmi3SetShiftDecimal, REFERENCES, const fmi3Float64 shifts[])
CALL(fmi3SetShiftFraction, REFERENCES, const fmi3UInt64 counters[],
     const fmi3UInt64 resolutions[])
CALL(fmi3ActivateModelPartition, fmi3ValueReference clock, fmi3Float64 time)

BARE_CALL(fmi3EnterContinuousTimeMode)
CALL(fmi3CompletedIntegratorStep, fmi3Boolean noSetState, fmi3Boolean *enterEventMode,
     fmi3Boolean *terminate)
CALL(fmi3SetTime, fmi3Float64 time)
CALL(fmi3SetContinuousStates, const fmi3Float64 states[], size_t n)
CALL(fmi3GetContinuousStateDerivatives, fmi3Float64 derivatives[], size_t n)
CALL(fmi3GetEventIndicators, fmi3Float64 indicators[], size_t n)
CALL(fmi3GetContinuousStates, fmi3Float64 states[], size_t n)
CALL(fmi3GetNominalsOfContinuousStates, fmi3Float64 nominals[], size_t n)
CALL(fmi3GetNumberOfEventIndicators, size_t *n)
CALL(fmi3GetNumberOfContinuousStates, size_t *n)
