/* riginv.rig.subtree_jacobian.SubtreeJacobian.gram: J^T G J of skinning matrices by controls that move subtrees of joints. */

/* sum (4,4) = a (4,4) g (4,4) b^T, with g's rows `ld` apart. */
static inline void NAME(block)(const REAL *a, const REAL *g, Index ld, const REAL *b, REAL *sum) {
    REAL half[16];
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            REAL value = 0;
            for (int k = 0; k < 4; k++) value += a[4 * i + k] * g[k * ld + j];
            half[4 * i + j] = value;
        }
    for (int i = 0; i < 4; i++)
        for (int j = 0; j < 4; j++) {
            REAL value = 0;
            for (int k = 0; k < 4; k++) value += half[4 * i + k] * b[4 * j + k];
            sum[4 * i + j] = value;
        }
}

/* Add the blocks of each joint (joint,) to its parent's, the deepest joints first; `width` numbers each. */
static void NAME(add_up)(REAL *values, Index width, const Index *order, const Index *parents, Index joints) {
    for (Index number = 0; number < joints; number++) {
        const Index joint = order[number], above = parents[joint];
        if (above < 0) continue;
        REAL *to = values + above * width;
        const REAL *from = values + joint * width;
        for (Index k = 0; k < width; k++) to[k] += from[k];
    }
}

/* blocks (joint, 4, 4 joint); matrices (batch, joint, 4, 4); order (joint,), the deepest first; owners (control,);
 * generators (batch, control, 3, 4); result (batch, control, control). */
API int NAME(subtree_gram)(const REAL *blocks, const REAL *matrices, const Index *parents, const Index *order, Index joints,
                           const Index *owners, const REAL *generators, Index controls, REAL *result, Index batch) {
    const Index ld = 4 * joints, row = 16 * joints;
    REAL *sums = malloc(sizeof(REAL) * (size_t)(joints * row)), *half = malloc(sizeof(REAL) * (size_t)(12 * joints));
    char *shared = malloc((size_t)(joints * joints));
    if (!sums || !half || !shared) return free(sums), free(half), free(shared), 1;
    for (Index one = 0; one < joints; one++)
        for (Index other = 0; other < joints; other++) {
            const REAL *block = blocks + one * 4 * ld + other * 4;
            char found = 0;
            for (int i = 0; i < 4; i++)
                for (int j = 0; j < 4; j++) found |= block[i * ld + j] != 0;
            shared[one * joints + other] = found;
        }
    for (Index mesh = 0; mesh < batch; mesh++) {
        const REAL *matrix = matrices + mesh * row, *generator = generators + mesh * controls * 12;
        REAL *out = result + mesh * controls * controls;
        memset(sums, 0, sizeof(REAL) * (size_t)(joints * row));
        for (Index one = 0; one < joints; one++)
            for (Index other = 0; other < joints; other++)
                if (shared[one * joints + other])
                    NAME(block)(matrix + 16 * one, blocks + one * 4 * ld + other * 4, ld, matrix + 16 * other, sums + one * row + other * 16);
        NAME(add_up)(sums, row, order, parents, joints);
        for (Index one = 0; one < joints; one++) NAME(add_up)(sums + one * row, 16, order, parents, joints);
        for (Index first = 0; first < controls; first++) {
            const REAL *x = generator + 12 * first, *sum = sums + owners[first] * row;
            for (Index joint = 0; joint < joints; joint++, sum += 16)
                for (int i = 0; i < 3; i++)
                    for (int j = 0; j < 4; j++)
                        half[12 * joint + 4 * i + j] = (x[4 * i] * sum[j] + x[4 * i + 1] * sum[4 + j]) +
                                                       (x[4 * i + 2] * sum[8 + j] + x[4 * i + 3] * sum[12 + j]);
            for (Index second = first; second < controls; second++) {
                const REAL *y = generator + 12 * second, *h = half + 12 * owners[second];
                REAL value = 0;
                for (int k = 0; k < 12; k++) value += h[k] * y[k];
                out[first * controls + second] = out[second * controls + first] = value;
            }
        }
    }
    free(sums), free(half), free(shared);
    return 0;
}
