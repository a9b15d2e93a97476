/* riginv.tracking.rigid.fit_rigid: robust rigid motion between two meshes. Sums are in float64. */

/* The median of values (count,), the lower one of two, which are reordered (Hoare's selection). */
static REAL NAME(median)(REAL *values, Index count) {
    const Index wanted = (count - 1) / 2;
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

/* The motion (12,), rotation and translation row by row, that maps source to target (point, 3) best, by weights (point,). */
static void NAME(register_points)(const REAL *source, const REAL *target, const REAL *weights, Index points, double *motion) {
    double from[3] = {0}, to[3] = {0}, total = 0, h[3][3] = {{0}}, rotation[9];
    for (Index point = 0; point < points; point++) {
        const double weight = weights[point];
        if (weight == 0) continue;
        total += weight;
        for (int axis = 0; axis < 3; axis++) {
            from[axis] += weight * source[3 * point + axis];
            to[axis] += weight * target[3 * point + axis];
        }
    }
    for (int axis = 0; axis < 3; axis++) from[axis] /= total, to[axis] /= total;
    for (Index point = 0; point < points; point++) {
        const double weight = weights[point];
        if (weight == 0) continue;
        for (int row = 0; row < 3; row++)
            for (int column = 0; column < 3; column++)
                h[row][column] += weight * (target[3 * point + row] - to[row]) * (source[3 * point + column] - from[column]);
    }
    rotation_of(h, rotation);
    for (int row = 0; row < 3; row++) {
        const double *r = rotation + 3 * row;
        motion[4 * row] = r[0], motion[4 * row + 1] = r[1], motion[4 * row + 2] = r[2];
        motion[4 * row + 3] = to[row] - r[0] * from[0] - r[1] * from[1] - r[2] * from[2];
    }
}

/* motion (frame, 4, 4) from source (frame, point, 3), or one of them where `shared`, to target (frame, point, 3), in which NaN
 * is not known; base (point,). Where `started`, motion holds approximate ones. numbers: scale of the weights in median
 * distances, its lower bound, and the mean displacement that ends the iterations. The identity where fewer than three points
 * count.
 */
API int NAME(fit_rigid)(const REAL *source, Index shared, const REAL *target, const REAL *base, const REAL *numbers, Index started,
                        Index iterations, Index points, REAL *motion, Index frames) {
    REAL *known = malloc(sizeof(REAL) * (size_t)(6 * points + 1));
    if (!known) return 1;
    REAL *weights = known + points, *squares = weights + points, *moved = squares + points;
    for (Index frame = 0; frame < frames; frame++) {
        const REAL *from = source + (shared ? 0 : 3 * frame * points), *to = target + 3 * frame * points;
        double m[12], step[12];
        Index counted = 0;
        for (Index point = 0; point < points; point++) {
            const REAL *p = to + 3 * point;
            known[point] = isfinite(p[0]) && isfinite(p[1]) && isfinite(p[2]) ? base[point] : 0;
            counted += known[point] > 0;
        }
        REAL *found = motion + 16 * frame;
        for (int k = 0; k < 12; k++) m[k] = started ? (double)found[k] : (double)(k % 5 == 0);
        if (counted >= 3) {
            if (!started) NAME(register_points)(from, to, known, points, m);
            for (Index number = 0; number <= iterations; number++) {
                double change = 0;
                Index seen = 0;
                for (Index point = 0; point < points; point++) {
                    const REAL *p = from + 3 * point, *q = to + 3 * point;
                    double square = 0, change_square = 0;
                    for (int axis = 0; axis < 3; axis++) {
                        const double *r = m + 4 * axis, at = r[0] * p[0] + r[1] * p[1] + r[2] * p[2] + r[3];
                        const double apart = number ? at - moved[3 * point + axis] : 0;
                        change_square += apart * apart;
                        square += (at - q[axis]) * (at - q[axis]);
                        moved[3 * point + axis] = (REAL)at;
                    }
                    change += sqrt(change_square);
                    weights[point] = (REAL)square;
                    if (isfinite(square)) squares[seen++] = (REAL)square;
                }
                if (number == iterations || (number && change < numbers[2] * points)) break;
                const REAL typical = numbers[0] * SQRT(NAME(median)(squares, seen));
                const REAL scale = typical < numbers[1] ? numbers[1] : typical;
                for (Index point = 0; point < points; point++) {
                    const REAL apart = 1 + weights[point] / (scale * scale);
                    weights[point] = known[point] > 0 ? known[point] / (apart * apart) : 0;
                }
                NAME(register_points)(from, to, weights, points, step);
                memcpy(m, step, sizeof m);
            }
        } else {
            for (int k = 0; k < 12; k++) m[k] = k % 5 == 0;
        }
        for (int k = 0; k < 12; k++) found[k] = (REAL)m[k];
        for (int k = 12; k < 16; k++) found[k] = k == 15;
    }
    free(known);
    return 0;
}
