/* riginv.tracking.rigid.fit_rigid: robust rigid motion between two meshes. Sums are in float64. */

/* The value of rank `wanted` of values (count,), which are reordered (Hoare's selection). */
static REAL NAME(select)(REAL *values, Index count, Index wanted) {
    Index low = 0, high = count - 1;
    while (low < high) {
        const REAL pivot = values[low + (high - low) / 2];
        Index left = low, right = high;
        while (left <= right) {
            while (values[left] < pivot) left++;
            while (values[right] > pivot) right--;
            if (left <= right) {
                const REAL swapped = values[left];
                values[left++] = values[right];
                values[right--] = swapped;
            }
        }
        if (wanted <= right)
            high = right;
        else if (wanted >= left)
            low = left;
        else
            break;
    }
    return values[wanted];
}

#ifndef EXACT
#define BUCKETS 4096
#define BUCKET_BITS 19 /* of a float32 that do not count */

/* Values from 0 upwards in the same order as the values: what a float32's exponent and the first bits of its mantissa make. */
static inline uint32_t bucket_of(float value) {
    uint32_t bits;
    memcpy(&bits, &value, sizeof bits);
    return (bits & 0x7fffffff) >> BUCKET_BITS; /* whatever the sign of a NaN */
}
#endif

/* The median of values (count,) from 0 upwards, the lower one of two; they are reordered. Counted in buckets first: comparing
 * values is slow where the outcome cannot be predicted.
 */
static REAL NAME(median)(REAL *values, Index count) {
    int32_t counts[BUCKETS] = {0};
    for (Index k = 0; k < count; k++) counts[bucket_of((float)values[k])]++;
    Index wanted = (count - 1) / 2, kept = 0;
    uint32_t bucket = 0;
    while (wanted >= counts[bucket]) wanted -= counts[bucket++];
    for (Index k = 0; k < count; k++) {
        const REAL value = values[k];
        values[kept] = value; /* kept <= k */
        kept += bucket_of((float)value) == bucket;
    }
    return NAME(select)(values, kept, wanted);
}

#ifndef EXACT
/* The unit quaternion of the rotation that maximises trace(R^T H): the largest eigenvector of Horn's matrix, by Jacobi's method.
 * rotation (3, 3), row by row.
 */
static void rotation_of(const double h[3][3], double *rotation) {
    double a[4][4] = {
        {h[0][0] + h[1][1] + h[2][2], h[2][1] - h[1][2], h[0][2] - h[2][0], h[1][0] - h[0][1]},
        {0, h[0][0] - h[1][1] - h[2][2], h[1][0] + h[0][1], h[0][2] + h[2][0]},
        {0, 0, h[1][1] - h[0][0] - h[2][2], h[2][1] + h[1][2]},
        {0, 0, 0, h[2][2] - h[0][0] - h[1][1]},
    };
    double v[4][4] = {{1, 0, 0, 0}, {0, 1, 0, 0}, {0, 0, 1, 0}, {0, 0, 0, 1}};
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < i; j++) a[i][j] = a[j][i];
    for (int sweep = 0; sweep < 30; sweep++) {
        double outside = 0, size = 0;
        for (int i = 0; i < 4; i++)
            for (int j = 0; j < 4; j++) *(i == j ? &size : &outside) += a[i][j] * a[i][j];
        if (outside <= 1e-30 * size) break;
        for (int p = 0; p < 3; p++)
            for (int q = p + 1; q < 4; q++) {
                if (a[p][q] == 0) continue;
                const double theta = (a[q][q] - a[p][p]) / (2 * a[p][q]);
                const double t = (theta < 0 ? -1 : 1) / (fabs(theta) + sqrt(theta * theta + 1));
                const double c = 1 / sqrt(t * t + 1), s = t * c;
                for (int k = 0; k < 4; k++) {
                    const double one = a[k][p], two = a[k][q];
                    a[k][p] = c * one - s * two, a[k][q] = s * one + c * two;
                }
                for (int k = 0; k < 4; k++) {
                    const double one = a[p][k], two = a[q][k];
                    a[p][k] = c * one - s * two, a[q][k] = s * one + c * two;
                }
                for (int k = 0; k < 4; k++) {
                    const double one = v[k][p], two = v[k][q];
                    v[k][p] = c * one - s * two, v[k][q] = s * one + c * two;
                }
            }
    }
    int best = 0;
    for (int k = 1; k < 4; k++)
        if (a[k][k] > a[best][best]) best = k;
    const double w = v[0][best], x = v[1][best], y = v[2][best], z = v[3][best];
    const double found[9] = {
        w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z,
    };
    memcpy(rotation, found, sizeof found);
}
#endif

/* Points (3, point), an axis after the other. */
static void NAME(by_axis)(const REAL *points, Index count, double *result) {
    for (int axis = 0; axis < 3; axis++)
        for (Index point = 0; point < count; point++) result[axis * count + point] = points[3 * point + axis];
}

#ifndef EXACT
/* The motion (12,), rotation and translation row by row, that maps source to target (3, point) best, by weights (point,). */
static void register_points(const double *source, const double *target, const double *weights, Index points, double *motion) {
    const double *px = source, *py = px + points, *pz = py + points, *qx = target, *qy = qx + points, *qz = qy + points;
    double total = 0, a = 0, b = 0, c = 0, u = 0, v = 0, w = 0, h[3][3], rotation[9];
#pragma omp simd reduction(+ : total, a, b, c, u, v, w)
    for (Index k = 0; k < points; k++) {
        const double weight = weights[k];
        total += weight;
        a += weight * px[k], b += weight * py[k], c += weight * pz[k];
        u += weight * qx[k], v += weight * qy[k], w += weight * qz[k];
    }
    const double from[3] = {a / total, b / total, c / total}, to[3] = {u / total, v / total, w / total};
    for (int row = 0; row < 3; row++) {
        const double *q = target + row * points, at = to[row];
        double x = 0, y = 0, z = 0;
#pragma omp simd reduction(+ : x, y, z)
        for (Index k = 0; k < points; k++) {
            const double apart = weights[k] * (q[k] - at);
            x += apart * (px[k] - from[0]), y += apart * (py[k] - from[1]), z += apart * (pz[k] - from[2]);
        }
        h[row][0] = x, h[row][1] = y, h[row][2] = z;
    }
    rotation_of(h, rotation);
    for (int row = 0; row < 3; row++) {
        const double *r = rotation + 3 * row;
        motion[4 * row] = r[0], motion[4 * row + 1] = r[1], motion[4 * row + 2] = r[2];
        motion[4 * row + 3] = to[row] - r[0] * from[0] - r[1] * from[1] - r[2] * from[2];
    }
}

/* The sum of the distances between points (3, point) and, as `moved` before the call, what an earlier motion made of them; then
 * moved (3, point) is what this motion (12,) makes of them, and squares (point,) their squared distances from target (3, point).
 */
static double move_points(const double *motion, const double *source, const double *target, Index points, double *moved,
                          double *squares) {
    double change = 0;
    const double *m = motion;
#pragma omp simd reduction(+ : change)
    for (Index k = 0; k < points; k++) {
        const double px = source[k], py = source[points + k], pz = source[2 * points + k];
        const double x = m[0] * px + m[1] * py + m[2] * pz + m[3], y = m[4] * px + m[5] * py + m[6] * pz + m[7],
                     z = m[8] * px + m[9] * py + m[10] * pz + m[11];
        const double u = x - moved[k], v = y - moved[points + k], w = z - moved[2 * points + k];
        const double i = x - target[k], j = y - target[points + k], l = z - target[2 * points + k];
        change += sqrt(u * u + v * v + w * w);
        squares[k] = i * i + j * j + l * l;
        moved[k] = x, moved[points + k] = y, moved[2 * points + k] = z;
    }
    return change;
}
#endif

/* motion (frame, 4, 4) from source (frame, point, 3), or one of them where `shared`, to target (frame, point, 3), in which NaN
 * is not known; base (point,). Where `started`, motion holds approximate ones. numbers: scale of the weights in median
 * distances, its lower bound, and the mean displacement that ends the iterations. The identity where fewer than three points
 * count.
 */
API int NAME(fit_rigid)(const REAL *source, Index shared, const REAL *target, const REAL *base, const REAL *numbers, Index started,
                        Index iterations, Index points, REAL *motion, Index frames) {
    double *from = malloc(sizeof(double) * (size_t)(13 * points + 1));
    if (!from) return 1;
    double *to = from + 3 * points, *moved = to + 3 * points, *known = moved + 3 * points, *weights = known + points;
    double *squares = weights + points;
    REAL *sorted = (REAL *)(squares + points);
    for (Index frame = 0; frame < frames; frame++) {
        double m[12];
        Index counted = 0;
        NAME(by_axis)(source + (shared ? 0 : 3 * frame * points), points, from);
        NAME(by_axis)(target + 3 * frame * points, points, to);
        for (Index point = 0; point < points; point++) {
            const int is_known = isfinite(to[point]) && isfinite(to[points + point]) && isfinite(to[2 * points + point]);
            known[point] = is_known ? base[point] : -1;
            counted += known[point] > 0;
            for (int axis = 0; axis < 3 && !is_known; axis++) to[axis * points + point] = 0;
        }
        for (Index point = 0; point < points; point++) weights[point] = known[point] > 0 ? known[point] : 0;
        REAL *found = motion + 16 * frame;
        for (int k = 0; k < 12; k++) m[k] = started ? (double)found[k] : (double)(k % 5 == 0);
        if (counted >= 3) {
            if (!started) register_points(from, to, weights, points, m);
            memset(moved, 0, sizeof(double) * (size_t)(3 * points));
            for (Index number = 0; number <= iterations; number++) {
                const double change = move_points(m, from, to, points, moved, squares);
                if (number == iterations || (number && change < numbers[2] * points)) break;
                Index seen = 0;
                for (Index point = 0; point < points; point++) {
                    sorted[seen] = (REAL)squares[point];
                    seen += known[point] >= 0;
                }
                const double typical = numbers[0] * SQRT(NAME(median)(sorted, seen));
                const double scale = typical < numbers[1] ? numbers[1] : typical, factor = 1 / (scale * scale);
                for (Index point = 0; point < points; point++) {
                    const double apart = 1 + squares[point] * factor;
                    weights[point] = known[point] > 0 ? known[point] / (apart * apart) : 0;
                }
                register_points(from, to, weights, points, m);
            }
        } else {
            for (int k = 0; k < 12; k++) m[k] = k % 5 == 0;
        }
        for (int k = 0; k < 12; k++) found[k] = (REAL)m[k];
        for (int k = 12; k < 16; k++) found[k] = k == 15;
    }
    free(from);
    return 0;
}

/* result (frame,): the mean distance between what two motions (frame, 4, 4) make of points (frame, point, 3) each. */
API int NAME(rigid_change)(const REAL *before, const REAL *points_before, const REAL *after, const REAL *points_after, Index points,
                           REAL *result, Index frames) {
    for (Index frame = 0; frame < frames; frame++) {
        const REAL *m = before + 16 * frame, *n = after + 16 * frame;
        const REAL *p = points_before + 3 * frame * points, *q = points_after + 3 * frame * points;
        double total = 0;
        for (Index point = 0; point < points; point++, p += 3, q += 3) {
            const REAL x = n[0] * q[0] + n[1] * q[1] + n[2] * q[2] + n[3] - (m[0] * p[0] + m[1] * p[1] + m[2] * p[2] + m[3]);
            const REAL y = n[4] * q[0] + n[5] * q[1] + n[6] * q[2] + n[7] - (m[4] * p[0] + m[5] * p[1] + m[6] * p[2] + m[7]);
            const REAL z = n[8] * q[0] + n[9] * q[1] + n[10] * q[2] + n[11] - (m[8] * p[0] + m[9] * p[1] + m[10] * p[2] + m[11]);
            total += SQRT(x * x + y * y + z * z);
        }
        result[frame] = (REAL)(total / (points > 0 ? points : 1));
    }
    return 0;
}
