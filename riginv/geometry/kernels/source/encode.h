/* riginv.rig.sparse_basis: products of meshes with the rows of a matrix that are 0 at most vertices; in float32 alone.
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

/* result (MESHES,) += sums: in lanes of float64, which compilers do not find by themselves. */
static inline void add_eight(const Eight *sums, double *result) {
    typedef float Half __attribute__((vector_size(16)));
    typedef double Wide __attribute__((vector_size(32)));
    for (int half = 0; half < 2; half++, result += 4) {
        Half part;
        Wide wide;
        memcpy(&part, (const float *)sums + 4 * half, sizeof part);
        memcpy(&wide, result, sizeof wide);
        wide += __builtin_convertvector(part, Wide);
        memcpy(result, &wide, sizeof wide);
    }
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
    for (int number = 0; number < BLOCK; number++) add_eight(sums + number, result + (Index)row[number] * MESHES);
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

/* gather for the meshes from a number on, of which there are MESHES at most. */
static inline void gather_meshes(const float *vertices, const float *rest, Index numbers, const float *motion, const int32_t *member,
                                 Index mesh, Index batch, float *near) {
    for (Index number = mesh; number < mesh + MESHES && number < batch; number++)
        gather(vertices + number * numbers, rest, member, motion ? motion + 16 * number : NULL, near + number - mesh);
}

/* Asks for what gather_meshes will read, so that it is in the cache by then: a group's vertices lie far apart. */
static inline void fetch(const float *vertices, Index numbers, const int32_t *member, Index mesh, Index batch) {
    for (Index number = mesh; number < mesh + MESHES && number < batch; number++)
        for (int each = 0; each < GROUP / 3 && member[each] >= 0; each++)
            __builtin_prefetch(vertices + number * numbers + 3 * (Index)member[each]);
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
            gather_meshes(vertices, rest, numbers, motion, member, mesh, batch, near);
            if (mesh + MESHES < batch)
                fetch(vertices, numbers, member, mesh + MESHES, batch);
            else if (group + 1 < groups)
                fetch(vertices, numbers, member + GROUP / 3, 0, batch);
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

/* far (GROUP, MESHES): what the rows of a group make of its vertices, for the coefficients (rows + 1, MESHES) of MESHES meshes. */
static void decode_group(const float *values, const int32_t *row, Index count, const float *coefficients, float *far) {
    memset(far, 0, sizeof(float) * GROUP * MESHES);
    for (Index block = 0; block < count; block += BLOCK) {
        const float *factors = values + block * GROUP;
        Eight w[BLOCK];
        for (int number = 0; number < BLOCK; number++) w[number] = load_eight(coefficients + row[block + number] * MESHES);
        for (int k = 0; k < GROUP; k++, factors += BLOCK) {
            const Eight one = factors[0] * w[0] + factors[1] * w[1] + factors[2] * w[2] + factors[3] * w[3];
            const Eight two = factors[4] * w[4] + factors[5] * w[5] + factors[6] * w[6] + factors[7] * w[7];
            const Eight sum = load_eight(far + k * MESHES) + (one + two);
            memcpy(far + k * MESHES, &sum, sizeof sum);
        }
    }
}

/* result (batch, number): the rest mesh (number,) and what the rows make of it, for coefficients (batch / 8 rounded up, rows + 1, 8),
 * 0 in the last row; the rest as for encode.
 */
API int decode_f32(const float *rest, Index numbers, const int32_t *vertex, Index groups, const int32_t *start, const int32_t *row,
                   const float *values, Index rows, const float *coefficients, float *result, Index batch) {
    for (Index group = 0; group < groups; group++) {
        const int32_t *member = vertex + group * (GROUP / 3);
        const Index first = start[group], count = start[group + 1] - first;
        for (Index mesh = 0; mesh < batch; mesh += MESHES) {
            float far[GROUP * MESHES];
            decode_group(values + first * GROUP, row + first, count, coefficients + mesh * (rows + 1), far);
            for (int number = 0; number < GROUP / 3 && member[number] >= 0; number++)
                for (Index lane = 0; lane < MESHES && mesh + lane < batch; lane++)
                    for (int axis = 0; axis < 3; axis++) {
                        const Index at = 3 * (Index)member[number] + axis;
                        result[(mesh + lane) * numbers + at] = rest[at] + far[(3 * number + axis) * MESHES + lane];
                    }
        }
    }
    return 0;
}

/* Adds the distances of a group's vertices to results (7, MESHES): the number that is finite, their sum, the largest square, its
 * vertex, and the sum of squares; then the sum of the distances and of their squares from the rest mesh. Of meshes and of a rig's
 * meshes, near and far (GROUP, MESHES) are the displacements from the rest mesh.
 */
static void add_distances(const float *near, const float *far, const int32_t *member, double *results) {
    float known[MESHES] = {0}, total[MESHES] = {0}, squares[MESHES] = {0}, rest_total[MESHES] = {0}, rest_squares[MESHES] = {0};
    for (int number = 0; number < GROUP / 3 && member[number] >= 0; number++, near += 3 * MESHES, far += 3 * MESHES) {
        float square[MESHES], from_rest[MESHES];
        for (int mesh = 0; mesh < MESHES; mesh++) {
            const float x = near[mesh], y = near[MESHES + mesh], z = near[2 * MESHES + mesh];
            const float u = x - far[mesh], v = y - far[MESHES + mesh], w = z - far[2 * MESHES + mesh];
            square[mesh] = u * u + v * v + w * w;
            from_rest[mesh] = x * x + y * y + z * z;
            known[mesh] += square[mesh] <= FLT_MAX;
            total[mesh] += sqrtf(square[mesh]);
            squares[mesh] += square[mesh];
            rest_total[mesh] += sqrtf(from_rest[mesh]);
            rest_squares[mesh] += from_rest[mesh];
        }
        double *largest = results + 2 * MESHES, *farthest = results + 3 * MESHES;
        for (int mesh = 0; mesh < MESHES; mesh++)
            if (square[mesh] > largest[mesh] || (square[mesh] == largest[mesh] && member[number] < farthest[mesh]))
                largest[mesh] = square[mesh], farthest[mesh] = member[number];
    }
    for (int mesh = 0; mesh < MESHES; mesh++) {
        results[mesh] += known[mesh];
        results[MESHES + mesh] += total[mesh];
        results[4 * MESHES + mesh] += squares[mesh];
        results[5 * MESHES + mesh] += rest_total[mesh];
        results[6 * MESHES + mesh] += rest_squares[mesh];
    }
}

/* As encode, and the distances of the meshes from those of a rig, both in one pass: coefficients (batch / 8 rounded up, rows + 1, 8)
 * of the rig's meshes, 0 in the last row, which are never stored. distances (batch / 8 rounded up, 7, 8) as in add_distances.
 */
API int compare_f32(const float *vertices, const float *rest, Index numbers, const float *motion, const int32_t *vertex, Index groups,
                    const int32_t *start, const int32_t *row, const float *values, Index rows, const float *coefficients,
                    double *result, double *distances, Index batch) {
    const Index meshes = (batch + MESHES - 1) / MESHES * MESHES;
    memset(result, 0, sizeof(double) * (size_t)(meshes * (rows + 1)));
    memset(distances, 0, sizeof(double) * (size_t)(meshes * 7));
    for (Index mesh = 0; mesh < meshes; mesh += MESHES)
        for (int lane = 0; lane < MESHES; lane++) distances[7 * mesh + 2 * MESHES + lane] = -1;
    for (Index group = 0; group < groups; group++) {
        const int32_t *member = vertex + group * (GROUP / 3);
        const Index first = start[group], last = start[group + 1];
        for (Index mesh = 0; mesh < batch; mesh += MESHES) {
            float near[GROUP * MESHES] = {0}, far[GROUP * MESHES];
            gather_meshes(vertices, rest, numbers, motion, member, mesh, batch, near);
            if (mesh + MESHES < batch)
                fetch(vertices, numbers, member, mesh + MESHES, batch);
            else if (group + 1 < groups)
                fetch(vertices, numbers, member + GROUP / 3, 0, batch);
            decode_group(values + first * GROUP, row + first, last - first, coefficients + mesh * (rows + 1), far);
            add_distances(near, far, member, distances + 7 * mesh);
            for (Index block = first; block < last; block += BLOCK)
                multiply_meshes(near, values + block * GROUP, row + block, result + mesh * (rows + 1));
        }
    }
    return 0;
}

#undef GROUP
#undef BLOCK
#undef MESHES
#undef ABREAST
