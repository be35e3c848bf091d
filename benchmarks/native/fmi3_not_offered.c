/* The functions of FMI 3.0 that models for fmi_model.h have no use for. Every FMU must have them, and FMPy looks for all; they
   return error. Without the standard's header, whose arguments they leave alone. */

#define REFUSES(name) int fmi3##name(void) { return 3; }
void *fmi3InstantiateScheduledExecution(void) { return (void *)0; }
REFUSES(ActivateModelPartition) REFUSES(EnterConfigurationMode) REFUSES(EvaluateDiscreteStates)
REFUSES(ExitConfigurationMode) REFUSES(GetAdjointDerivative) REFUSES(GetBinary) REFUSES(GetBoolean) REFUSES(GetClock)
REFUSES(GetFloat32) REFUSES(GetInt16) REFUSES(GetInt32) REFUSES(GetInt64) REFUSES(GetInt8)
REFUSES(GetIntervalDecimal) REFUSES(GetIntervalFraction) REFUSES(GetNumberOfVariableDependencies)
REFUSES(GetOutputDerivatives) REFUSES(GetShiftDecimal) REFUSES(GetShiftFraction) REFUSES(GetString)
REFUSES(GetUInt16) REFUSES(GetUInt32) REFUSES(GetUInt64) REFUSES(GetUInt8) REFUSES(GetVariableDependencies)
REFUSES(SetBinary) REFUSES(SetBoolean) REFUSES(SetClock) REFUSES(SetFloat32) REFUSES(SetInt16) REFUSES(SetInt32)
REFUSES(SetInt64) REFUSES(SetInt8) REFUSES(SetIntervalDecimal) REFUSES(SetIntervalFraction) REFUSES(SetShiftDecimal)
REFUSES(SetShiftFraction) REFUSES(SetString) REFUSES(SetUInt16) REFUSES(SetUInt32) REFUSES(SetUInt64)
REFUSES(SetUInt8)
