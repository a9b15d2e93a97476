/* riginv.rig.joint_features.JointFeatures: angles, translations and scales of joints relative to the joint above them. */

/* result (3, 3): the inverse of a (3, 3), whose determinant counts as `least` at the least. */
static inline void NAME(invert_3x3)(const REAL *a, REAL least, REAL *result) {
    REAL determinant = 0;
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++) {
            const int one = (row + 1) % 3, two = (row + 2) % 3, up = (column + 1) % 3, down = (column + 2) % 3;
            result[3 * row + column] = a[3 * up + one] * a[3 * down + two] - a[3 * down + one] * a[3 * up + two];
        }
    for (int row = 0; row < 3; row++) determinant += a[3 * row] * result[row];
    determinant = determinant < least ? least : determinant;
    for (int number = 0; number < 9; number++) result[number] /= determinant;
}

/* matrices (batch, matrix, 3, 4): changes from rest. Of each joint: source, the index of its matrix; parents, -1: a root; rest
 * (joint, 3, 4); inverse_rest (joint, 3, 3); shift (joint, 3); orders (joint, 3). least (3,): determinant, scale, cosine of the
 * middle angle in gimbal lock. angles, moves and scales (batch, joint, 3).
 */
API int NAME(joint_features)(const REAL *matrices, Index count, const Index *source, const Index *parents, const REAL *rest,
                             const REAL *inverse_rest, const REAL *shift, const Index *orders, Index joints, const REAL *least,
                             REAL *angles, REAL *moves, REAL *scales, Index batch) {
    REAL *linears = malloc(sizeof(REAL) * (size_t)(12 * joints + 1)), *positions = linears + 9 * joints;
    if (!linears) return 1;
    for (Index row = 0; row < batch; row++, matrices += 12 * count) {
        for (Index joint = 0; joint < joints; joint++)
            for (int axis = 0; axis < 3; axis++) {
                const REAL *change = matrices + 12 * source[joint] + 4 * axis, *away = shift + 3 * joint;
                for (int column = 0; column < 3; column++) linears[9 * joint + 3 * axis + column] = change[column] + (axis == column);
                positions[3 * joint + axis] = rest[12 * joint + 4 * axis + 3] + change[3] +
                                              (change[0] * away[0] + change[1] * away[1] + change[2] * away[2]);
            }
        for (Index joint = 0; joint < joints; joint++, angles += 3, moves += 3, scales += 3) {
            const Index above = parents[joint], *order = orders + 3 * joint;
            const REAL *place = rest + 12 * joint;
            REAL inverse[9] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, outer[9], inner[9], local[9], apart[3], between[3];
            if (above >= 0) NAME(invert_3x3)(linears + 9 * above, least[0], inverse);
            NAME(multiply_3x3)(inverse_rest + 9 * joint, 3, inverse, 3, outer, 3);
            NAME(multiply_3x3)(linears + 9 * joint, 3, place, 4, inner, 3);
            NAME(multiply_3x3)(outer, 3, inner, 3, local, 3);
            for (int axis = 0; axis < 3; axis++) {
                apart[axis] = positions[3 * joint + axis] - (above >= 0 ? positions[3 * above + axis] : 0);
                between[axis] = place[4 * axis + 3] - (above >= 0 ? rest[12 * above + 4 * axis + 3] : 0);
            }
            for (int axis = 0; axis < 3; axis++) {
                scales[axis] = SQRT(local[axis] * local[axis] + local[3 + axis] * local[3 + axis] + local[6 + axis] * local[6 + axis]);
                moves[axis] = inverse[3 * axis] * apart[0] + inverse[3 * axis + 1] * apart[1] + inverse[3 * axis + 2] * apart[2] -
                              between[axis];
                const REAL size = scales[axis] < least[1] ? least[1] : scales[axis];
                for (int number = axis; number < 9; number += 3) local[number] /= size;
            }
            const Index first = order[0], middle = order[1], last = order[2];
            const REAL sign = (middle - first + 3) % 3 == 1 ? 1 : -1;
            const REAL cosine = SQRT(local[4 * first] * local[4 * first] + local[3 * first + middle] * local[3 * first + middle]);
            angles[middle] = ATAN2(sign * local[3 * first + last], cosine);
            if (cosine < least[2]) {
                angles[first] = ATAN2(sign * local[3 * last + middle], local[4 * middle]);
                angles[last] = 0;
            } else {
                angles[first] = ATAN2(-sign * local[3 * middle + last], local[4 * last]);
                angles[last] = ATAN2(-sign * local[3 * first + middle], local[4 * first]);
            }
        }
    }
    free(linears);
    return 0;
}
