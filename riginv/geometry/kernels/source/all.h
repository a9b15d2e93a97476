/* Every kernel, in the precision that kernels.c has chosen. */

#include "curves.h"
#include "products.h"
#include "sandwich.h"
#include "subtrees.h"
#include "cholesky.h"
#include "box_step.h"
#include "shapes.h"
#include "rigid.h"
#include "distances.h"
#include "skeleton.h"
#include "joint_features.h"
#include "quasi_newton.h"

#undef PADDING
#undef ROWS
#undef LANES
