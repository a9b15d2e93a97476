/* A skeleton whose joints rotate by three angles: the coefficients of rigs.body, forward and backward.
 *
 * A joint's rotation relative to its parent is F X(a) Z(b) Y(c) F^T with its frame F; parents (joint,) come before their children,
 * -1 for a root. Transforms are (3, 4).
 */

static inline void NAME(multiply_3x3)(const REAL *a, Index a_ld, const REAL *b, Index b_ld, REAL *result, Index ld) {
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++)
            result[row * ld + column] =
                a[row * a_ld] * b[column] + a[row * a_ld + 1] * b[b_ld + column] + a[row * a_ld + 2] * b[2 * b_ld + column];
}

/* result (3, 3) = a b^T. */
static inline void NAME(multiply_transposed)(const REAL *a, Index a_ld, const REAL *b, Index b_ld, REAL *result, Index ld) {
    for (int row = 0; row < 3; row++)
        for (int column = 0; column < 3; column++)
            result[row * ld + column] = a[row * a_ld] * b[column * b_ld] + a[row * a_ld + 1] * b[column * b_ld + 1] +
                                        a[row * a_ld + 2] * b[column * b_ld + 2];
}

/* euler (3, 3): X(a) Z(b) Y(c); rotation (3, 3): the same in the frame (3, 3). */
static inline void NAME(rotate)(const REAL *angles, const REAL *frame, REAL *euler, REAL *rotation) {
    const REAL sa = SIN(angles[0]), ca = COS(angles[0]), sb = SIN(angles[1]), cb = COS(angles[1]), sc = SIN(angles[2]), cc = COS(angles[2]);
    const REAL found[9] = {cb * cc,          -sb,     cb * sc,
                           ca * sb * cc + sa * sc, ca * cb, ca * sb * sc - sa * cc,
                           sa * sb * cc - ca * sc, sa * cb, sa * sb * sc + ca * cc};
    REAL outer[9];
    memcpy(euler, found, sizeof found);
    NAME(multiply_3x3)(frame, 3, found, 3, outer, 3);
    NAME(multiply_transposed)(outer, 3, frame, 3, rotation, 3);
}

/* angles (batch, joint, 3), radians; move (batch, 3), of the roots; frames (joint, 3, 3); offsets (joint, 3) from the parent.
 * worlds (batch, joint, 3, 4).
 */
API int NAME(skeleton)(const REAL *angles, const REAL *move, const REAL *frames, const REAL *offsets, const Index *parents,
                       Index joints, REAL *worlds, Index batch) {
    for (Index row = 0; row < batch; row++, angles += 3 * joints, worlds += 12 * joints)
        for (Index joint = 0; joint < joints; joint++) {
            REAL euler[9], rotation[9], *world = worlds + 12 * joint;
            const REAL *offset = offsets + 3 * joint, *above = worlds + 12 * parents[joint];
            NAME(rotate)(angles + 3 * joint, frames + 9 * joint, euler, rotation);
            if (parents[joint] < 0) {
                for (int axis = 0; axis < 3; axis++) {
                    memcpy(world + 4 * axis, rotation + 3 * axis, 3 * sizeof(REAL));
                    world[4 * axis + 3] = offset[axis] + move[3 * row + axis];
                }
                continue;
            }
            NAME(multiply_3x3)(above, 4, rotation, 3, world, 4);
            for (int axis = 0; axis < 3; axis++)
                world[4 * axis + 3] = above[4 * axis] * offset[0] + above[4 * axis + 1] * offset[1] + above[4 * axis + 2] * offset[2] +
                                      above[4 * axis + 3];
        }
    return 0;
}

/* gradient (batch, joint, 3, 4), which is overwritten, to those by angles (batch, joint, 3) and move (batch, 3). */
API int NAME(skeleton_pull)(const REAL *angles, const REAL *frames, const REAL *offsets, const Index *parents, Index joints,
                            const REAL *worlds, REAL *gradient, REAL *of_angles, REAL *of_move, Index batch) {
    for (Index row = 0; row < batch; row++, of_move += 3) {
        memset(of_move, 0, 3 * sizeof(REAL));
        for (Index joint = joints - 1; joint >= 0; joint--) {
            REAL euler[9], rotation[9], part[9], local[9], turned[9], spin[3];
            const Index here = row * joints + joint, parent = parents[joint];
            const REAL *frame = frames + 9 * joint, *offset = offsets + 3 * joint, *given = gradient + 12 * here;
            NAME(rotate)(angles + 3 * here, frame, euler, rotation);
            if (parent < 0) {
                for (int axis = 0; axis < 3; axis++) {
                    of_move[axis] += given[4 * axis + 3];
                    memcpy(local + 3 * axis, given + 4 * axis, 3 * sizeof(REAL));
                }
            } else {
                REAL *above = gradient + 12 * (row * joints + parent);
                const REAL *world = worlds + 12 * (row * joints + parent);
                NAME(multiply_transposed)(given, 4, rotation, 3, part, 3);
                for (int axis = 0; axis < 3; axis++) {
                    for (int column = 0; column < 3; column++)
                        above[4 * axis + column] += part[3 * axis + column] + given[4 * axis + 3] * offset[column];
                    above[4 * axis + 3] += given[4 * axis + 3];
                    for (int column = 0; column < 3; column++)
                        local[3 * axis + column] =
                            world[axis] * given[column] + world[4 + axis] * given[4 + column] + world[8 + axis] * given[8 + column];
                }
            }
            /* local is the gradient by the rotation; by X Z Y it is F^T local F. */
            NAME(multiply_3x3)(local, 3, frame, 3, part, 3);
            for (int axis = 0; axis < 3; axis++)
                for (int column = 0; column < 3; column++)
                    turned[3 * axis + column] = frame[axis] * part[column] + frame[3 + axis] * part[3 + column] + frame[6 + axis] * part[6 + column];
            memset(spin, 0, sizeof spin);
            for (int column = 0; column < 3; column++)
                for (int axis = 0; axis < 3; axis++) {
                    const int one = 3 * ((axis + 1) % 3) + column, two = 3 * ((axis + 2) % 3) + column;
                    spin[axis] += euler[one] * turned[two] - euler[two] * turned[one];
                }
            REAL *found = of_angles + 3 * here;
            found[0] = spin[0];
            found[1] = COS(angles[3 * here]) * spin[2] - SIN(angles[3 * here]) * spin[1];
            found[2] = euler[1] * spin[0] + euler[4] * spin[1] + euler[7] * spin[2];
        }
    }
    return 0;
}
