/* Functions of FMI 3.0 that this FMU does not offer; included at the end of fmi3.c. They are exported
 * because importers look up every function. */
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
