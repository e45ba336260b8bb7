// Floating-point products are fused into sums nowhere that it is not asked for: images must not depend on how a compiler feels
// about a loop, and watertight intersection rests on it.
#pragma OPENCL FP_CONTRACT OFF
