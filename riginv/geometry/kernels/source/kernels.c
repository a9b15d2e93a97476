/* All kernels of riginv, once in float32 (names end in _f32) and once in float64 (_f64).
 *
 * Tensors are contiguous along their last dimension; `ld` is the distance between two rows, in numbers. Indices are int64, and
 * -1 means none. Every row of a batch is computed for itself, so that a result does not depend on what else is in the batch.
 * Functions return 0, or 1 where memory ran out.
 */

#include <float.h>
#include <math.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#if defined(_WIN32)
#define API __declspec(dllexport)
#else
#define API __attribute__((visibility("default")))
#endif

typedef int64_t Index;

#ifndef RIGINV_SOURCE
#define RIGINV_SOURCE ""
#endif

/* The digest of the source that this was compiled from. */
API const char *riginv_source(void) { return RIGINV_SOURCE; }

/* float64 first: float32 falls back to it. */
#define REAL double
#define NAME(name) name##_f64
#define EPSILON DBL_EPSILON
#define SMALLEST DBL_MIN
#define FABS fabs
#define SQRT sqrt
#define SIN sin
#define COS cos
#define ATAN2 atan2
#include "all.h"
#include "band.h"
#undef REAL
#undef NAME
#undef EPSILON
#undef SMALLEST
#undef FABS
#undef SQRT
#undef SIN
#undef COS
#undef ATAN2

#define EXACT
#define REAL float
#define NAME(name) name##_f32
#define EPSILON FLT_EPSILON
#define SMALLEST FLT_MIN
#define FABS fabsf
#define SQRT sqrtf
#define SIN sinf
#define COS cosf
#define ATAN2 atan2f
#include "all.h"
#include "encode.h"
#include "refinement.h"
