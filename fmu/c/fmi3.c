/* FMI 3.0 for Model Exchange and Co-Simulation: signatures and types of the standard on top of fmu_core.c.
 *
 * Functions that this FMU does not offer are exported too, because importers look up every
 * function: see the end.
 */
#include "fmi3Functions.h"

#include <stdlib.h>

#include "fmu_core.h"

typedef struct {
    Fmu fmu; /* first, so that a pointer to one is a pointer to the other */
    fmi3LogMessageCallback log;
    fmi3InstanceEnvironment environment;
    fmi3Boolean logging;
} Instance;

static fmi3Status done(Instance *self, int ok)
{
    if (ok == 1)
        return fmi3OK;
    fmi3Status status = ok == DISCARDED ? fmi3Discard : fmi3Error;
    if (self->logging && self->log)
        self->log(self->environment, status, "logStatusError", self->fmu.message);
    return status;
}

#define STATUS fmi3Status
#define OK fmi3OK
#define ERROR fmi3Error
#define HANDLE fmi3Instance
#define REFERENCE fmi3ValueReference
#include "fmi_calls.h"

/* ---- Creation and destruction -------------------------------------------------------------- */

const char *fmi3GetVersion(void) { return fmi3Version; }

fmi3Status fmi3SetDebugLogging(fmi3Instance instance, fmi3Boolean loggingOn, size_t nCategories,
                               const fmi3String categories[])
{
    ENTER(ANY_STATE);
    int ok = fmu_check_log_categories(fmu, categories, nCategories);
    if (ok)
        self->logging = loggingOn;
    return done(self, ok);
}

static fmi3Instance instantiate(int exchange, fmi3String token, fmi3Boolean loggingOn,
                                fmi3InstanceEnvironment environment, fmi3LogMessageCallback log,
                                fmi3Boolean eventModeUsed)
{
    Instance *self = calloc(1, sizeof *self);
    if (!self)
        return NULL;
    self->log = log;
    self->environment = environment;
    self->logging = loggingOn;
    self->fmu.exchange = exchange;
    fmu_reset(&self->fmu);
    int ok = eventModeUsed
                 ? fmu_refuse(&self->fmu, "The FMU has no event mode in Co-Simulation.")
                 : fmu_check_token(&self->fmu, token, "instantiation token");
    if (ok)
        return self;
    done(self, 0);
    free(self);
    return NULL;
}

fmi3Instance fmi3InstantiateCoSimulation(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3Boolean eventModeUsed,
    fmi3Boolean earlyReturnAllowed, const fmi3ValueReference requiredIntermediateVariables[],
    size_t nRequiredIntermediateVariables, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage, fmi3IntermediateUpdateCallback intermediateUpdate)
{
    return instantiate(0, instantiationToken, loggingOn, instanceEnvironment, logMessage,
                       eventModeUsed);
}

fmi3Instance fmi3InstantiateModelExchange(
    fmi3String instanceName, fmi3String instantiationToken, fmi3String resourcePath,
    fmi3Boolean visible, fmi3Boolean loggingOn, fmi3InstanceEnvironment instanceEnvironment,
    fmi3LogMessageCallback logMessage)
{
    return instantiate(1, instantiationToken, loggingOn, instanceEnvironment, logMessage,
                       fmi3False);
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
    ENTER(LEGAL_TO_ENTER);
    return done(self, fmu_start_at(fmu, startTime, stopTimeDefined, stopTime) &&
                          fmu_enter_initialization(fmu));
}

fmi3Status fmi3DoStep(fmi3Instance instance, fmi3Float64 currentCommunicationPoint,
                      fmi3Float64 communicationStepSize,
                      fmi3Boolean noSetFMUStatePriorToCurrentPoint,
                      fmi3Boolean *eventHandlingNeeded, fmi3Boolean *terminateSimulation,
                      fmi3Boolean *earlyReturn, fmi3Float64 *lastSuccessfulTime)
{
    ENTER(LEGAL_TO_STEP);
    int ok = fmu_step(fmu, currentCommunicationPoint, communicationStepSize);
    *eventHandlingNeeded = *terminateSimulation = *earlyReturn = fmi3False;
    *lastSuccessfulTime = fmu->memory.value[0];
    return done(self, ok);
}

/* ---- Variables ----------------------------------------------------------------------------- */

static int all_scalars(Fmu *fmu, size_t references, size_t values)
{
    return references == values ||
           fmu_refuse(fmu, "All variables are scalars: give one value for each.");
}

fmi3Status fmi3GetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Float64 values[], size_t nValues)
{
    ENTER(ANY_STATE);
    return done(self, all_scalars(fmu, nValueReferences, nValues)
                          ? fmu_get_float64(fmu, valueReferences, nValues, values)
                          : 0);
}

fmi3Status fmi3SetFloat64(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, const fmi3Float64 values[], size_t nValues)
{
    ENTER(LEGAL_TO_SET);
    return done(self, all_scalars(fmu, nValueReferences, nValues) &&
                          fmu_set_float64(fmu, valueReferences, nValues, values));
}

fmi3Status fmi3GetBoolean(fmi3Instance instance, const fmi3ValueReference valueReferences[],
                          size_t nValueReferences, fmi3Boolean values[], size_t nValues)
{
    ENTER(ANY_STATE);
    int truth, ok = all_scalars(fmu, nValueReferences, nValues) &&
                    fmu_check_booleans(fmu, valueReferences, nValues);
    for (size_t i = 0; ok && i < nValues; i++)
        if ((ok = fmu_get_boolean(fmu, valueReferences[i], &truth)))
            values[i] = truth;
    return done(self, ok);
}

/* ---- Derivatives --------------------------------------------------------------------------- */

fmi3Status fmi3GetDirectionalDerivative(
    fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
    fmi3Float64 slope[], size_t nSlope)
{
    ENTER(LEGAL_TO_GET);
    return done(self, all_scalars(fmu, nKnowns, nSeed) && all_scalars(fmu, nUnknowns, nSlope) &&
                          fmu_forward(fmu, unknowns, nUnknowns, knowns, nKnowns, seed, slope));
}

fmi3Status fmi3GetAdjointDerivative(
    fmi3Instance instance, const fmi3ValueReference unknowns[], size_t nUnknowns,
    const fmi3ValueReference knowns[], size_t nKnowns, const fmi3Float64 seed[], size_t nSeed,
    fmi3Float64 slope[], size_t nSlope)
{
    ENTER(LEGAL_TO_GET);
    return done(self, all_scalars(fmu, nUnknowns, nSeed) && all_scalars(fmu, nKnowns, nSlope) &&
                          fmu_reverse(fmu, unknowns, nUnknowns, knowns, nKnowns, seed, slope));
}

/* ---- A tick of the robot's loop in one call, beyond the standard ---------------------------- */

/* Set inputs, step where the step is positive, get values (a Boolean as 1 or 0). The first step ends
 * the initialization mode; a step of zero evaluates the outputs only. */
FMI3_Export fmi3Status dropstitch_tick(fmi3Instance instance, const fmi3ValueReference inputs[],
                                       size_t nInputs, const double values[], double step_s,
                                       const fmi3ValueReference outputs[], size_t nOutputs,
                                       double results[])
{
    ENTER(INITIALIZING | STEPPING);
    for (size_t i = 0; i < nOutputs; i++)
        if (outputs[i] >= FIRST_STATE) /* states and what follows from them are not in `value` */
            return done(self, fmu_refuse(fmu, "The value reference %u is no output of a tick.",
                                         (unsigned)outputs[i]));
    int ok = fmu_set_float64(fmu, inputs, nInputs, values);
    if (ok && step_s > 0.0 && fmu->memory.mode == INITIALIZING)
        ok = fmu_exit_initialization(fmu);
    if (ok && step_s > 0.0)
        ok = fmu_step(fmu, fmu->memory.value[0], step_s);
    else if (ok)
        ok = fmu_refresh(fmu);
    for (size_t i = 0; ok == 1 && i < nOutputs; i++)
        results[i] = fmu->memory.value[outputs[i]];
    return done(self, ok);
}

/* ---- Model Exchange ------------------------------------------------------------------------ */

fmi3Status fmi3EnterEventMode(fmi3Instance instance)
{
    ENTER(LEGAL_TO_INTEGRATE);
    return done(self, fmu_enter_event_mode(fmu));
}

fmi3Status fmi3UpdateDiscreteStates(fmi3Instance instance, fmi3Boolean *discreteStatesNeedUpdate,
                                    fmi3Boolean *terminateSimulation,
                                    fmi3Boolean *nominalsOfContinuousStatesChanged,
                                    fmi3Boolean *valuesOfContinuousStatesChanged,
                                    fmi3Boolean *nextEventTimeDefined, fmi3Float64 *nextEventTime)
{
    ENTER(LEGAL_TO_UPDATE);
    Update update;
    int ok = fmu_update(fmu, &update);
    if (ok) {
        *discreteStatesNeedUpdate = *terminateSimulation = fmi3False;
        *nominalsOfContinuousStatesChanged = fmi3False;
        *valuesOfContinuousStatesChanged = update.states_changed;
        *nextEventTimeDefined = fmi3True;
        *nextEventTime = update.next_s;
    }
    return done(self, ok);
}

fmi3Status fmi3GetNumberOfEventIndicators(fmi3Instance instance, size_t *nEventIndicators)
{
    ENTER(ANY_STATE);
    *nEventIndicators = N_INDICATORS;
    return fmi3OK;
}

fmi3Status fmi3GetNumberOfContinuousStates(fmi3Instance instance, size_t *nContinuousStates)
{
    ENTER(ANY_STATE);
    *nContinuousStates = N_CONTINUOUS;
    return fmi3OK;
}

/* ---- As in FMI 2.0 ------------------------------------------------------------------------- */

#define FMI(name) fmi3##name
#define FMU_STATE fmi3FMUState
#define BYTE fmi3Byte
#define TRUTH fmi3Boolean
#define FMI_GET_STATE fmi3GetFMUState
#define FMI_SET_STATE fmi3SetFMUState
#define FMI_FREE_STATE fmi3FreeFMUState
#define FMI_STATE_SIZE fmi3SerializedFMUStateSize
#define FMI_SERIALIZE fmi3SerializeFMUState
#define FMI_DESERIALIZE fmi3DeserializeFMUState
#define FMI_GET_RATES fmi3GetContinuousStateDerivatives
#define FMI_LEGAL_TO_GET_NOMINALS (LEGAL_TO_EVALUATE)
#include "fmi_shared.h"

/* ---- Not offered --------------------------------------------------------------------------- */

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
CALL(fmi3GetOutputDerivatives, REFERENCES, const fmi3Int32 orders[], fmi3Float64 values[],
     size_t nValues)

BARE_CALL(fmi3EnterStepMode)
BARE_CALL(fmi3EnterConfigurationMode)
BARE_CALL(fmi3ExitConfigurationMode)
BARE_CALL(fmi3EvaluateDiscreteStates)

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
