/* riginv.rig.sparse_encoder: products of meshes with the rows of a matrix that are 0 at most vertices; in float32 alone.
 *
 * The sum of a group of vertices is one chain of float32, and groups are summed in float64: no bit of a mesh's result depends on
 * the other meshes of a batch.
 */

#define GROUP 48 /* numbers of 16 vertices, which are read together */
#define BLOCK 8  /* rows that are multiplied together */
#define MESHES 8 /* and meshes */
#define ABREAST 4 /* blocks that are multiplied together for a single mesh */

typedef float Eight __attribute__((vector_size(32)));

static inline Eight load_eight(const float *from) {
    Eight lanes;
    memcpy(&lanes, from, sizeof lanes);
    return lanes;
}

/* result (row + 1, MESHES) += a block (GROUP, BLOCK) times the numbers of MESHES meshes (GROUP, MESHES). */
static void multiply_meshes(const float *near, const float *block, const int32_t *row, double *result) {
    Eight sums[BLOCK], s0 = {0}, s1 = {0}, s2 = {0}, s3 = {0}, s4 = {0}, s5 = {0}, s6 = {0}, s7 = {0};
    for (int k = 0; k < GROUP; k++) {
        const Eight values = load_eight(near + k * MESHES);
        const float *factors = block + k * BLOCK;
        s0 += factors[0] * values;
        s1 += factors[1] * values;
        s2 += factors[2] * values;
        s3 += factors[3] * values;
        s4 += factors[4] * values;
        s5 += factors[5] * values;
        s6 += factors[6] * values;
        s7 += factors[7] * values;
    }
    sums[0] = s0, sums[1] = s1, sums[2] = s2, sums[3] = s3, sums[4] = s4, sums[5] = s5, sums[6] = s6, sums[7] = s7;
    for (int number = 0; number < BLOCK; number++)
        for (int mesh = 0; mesh < MESHES; mesh++) result[row[number] * MESHES + mesh] += (double)sums[number][mesh];
}

/* The same for ABREAST blocks and the first mesh alone. */
static void multiply_blocks(const float *near, const float *blocks, const int32_t *row, double *result) {
    Eight sums[ABREAST], s0 = {0}, s1 = {0}, s2 = {0}, s3 = {0};
    for (int k = 0; k < GROUP; k++) {
        const float factor = near[k * MESHES];
        s0 += factor * load_eight(blocks + k * BLOCK);
        s1 += factor * load_eight(blocks + (GROUP + k) * BLOCK);
        s2 += factor * load_eight(blocks + (2 * GROUP + k) * BLOCK);
        s3 += factor * load_eight(blocks + (3 * GROUP + k) * BLOCK);
    }
    sums[0] = s0, sums[1] = s1, sums[2] = s2, sums[3] = s3;
    for (int block = 0; block < ABREAST; block++)
        for (int lane = 0; lane < BLOCK; lane++) result[row[block * BLOCK + lane] * MESHES] += (double)sums[block][lane];
}

/* The displacements (GROUP, MESHES) of a group's vertices from the rest mesh, for one mesh: near is that of its first number.
 * motion (4, 4) is removed; NULL: there is none.
 */
static inline void gather(const float *mesh, const float *rest, const int32_t *member, const float *motion, float *near) {
    for (int number = 0; number < GROUP / 3 && member[number] >= 0; number++, near += 3 * MESHES) {
        const float *from = mesh + 3 * (Index)member[number], *origin = rest + 3 * (Index)member[number];
        float moved[3] = {from[0], from[1], from[2]};
        if (motion) {
            const float x = from[0] - motion[3], y = from[1] - motion[7], z = from[2] - motion[11];
            for (int axis = 0; axis < 3; axis++) moved[axis] = x * motion[axis] + y * motion[4 + axis] + z * motion[8 + axis];
        }
        for (int axis = 0; axis < 3; axis++) near[axis * MESHES] = moved[axis] - origin[axis];
    }
}

/* vertices (batch, number), rest (number,), motion (batch, 4, 4) or NULL. vertex (group, 16): those of each group, -1 where there
 * are no more. The rows that a group counts in are row[start[group]] to row[start[group + 1]], a multiple of 8 with `rows` where
 * there are no more; values holds a block (48, 8) for each eight of them. result (batch / 8 rounded up, rows + 1, 8).
 */
API int encode_f32(const float *vertices, const float *rest, Index numbers, const float *motion, const int32_t *vertex,
                   Index groups, const int32_t *start, const int32_t *row, const float *values, Index rows, double *result,
                   Index batch) {
    memset(result, 0, sizeof(double) * (size_t)((batch + MESHES - 1) / MESHES * MESHES * (rows + 1)));
    for (Index group = 0; group < groups; group++) {
        const int32_t *member = vertex + group * (GROUP / 3);
        const Index last = start[group + 1];
        for (Index mesh = 0; mesh < batch; mesh += MESHES) {
            float near[GROUP * MESHES] = {0};
            for (Index number = mesh; number < mesh + MESHES && number < batch; number++)
                gather(vertices + number * numbers, rest, member, motion ? motion + 16 * number : NULL, near + number - mesh);
            double *sums = result + mesh * (rows + 1);
            Index block = start[group];
            if (batch == 1)
                for (; block + ABREAST * BLOCK <= last; block += ABREAST * BLOCK)
                    multiply_blocks(near, values + block * GROUP, row + block, sums);
            for (; block < last; block += BLOCK) multiply_meshes(near, values + block * GROUP, row + block, sums);
        }
    }
    return 0;
}

#undef GROUP
#undef BLOCK
#undef MESHES
#undef ABREAST
