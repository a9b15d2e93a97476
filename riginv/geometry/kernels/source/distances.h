/* riginv.geometry.distances.frame_distances: distances between vertices of meshes (frame, vertex, 3), summed up for each frame.
 *
 * other: as many meshes, or one where `shared`. counts (vertex,), 0 where a vertex does not count; NULL: all do. results
 * (frame, 5): the number of distances that are known, their sum, the largest, its vertex, and the sum of their squares.
 */
API int NAME(distances)(const REAL *meshes, const REAL *other, Index shared, const int8_t *counts, Index vertices, double *results,
                        Index frames) {
    for (Index frame = 0; frame < frames; frame++) {
        const REAL *one = meshes + 3 * frame * vertices, *two = other + (shared ? 0 : 3 * frame * vertices);
        double total = 0, squares = 0;
        REAL largest = -1;
        Index known = 0, farthest = 0;
        for (Index vertex = 0; vertex < vertices; vertex++) {
            const REAL x = one[3 * vertex] - two[3 * vertex], y = one[3 * vertex + 1] - two[3 * vertex + 1],
                       z = one[3 * vertex + 2] - two[3 * vertex + 2];
            const REAL square = x * x + y * y + z * z;
            if (!isfinite(square) || (counts && !counts[vertex])) continue;
            known++;
            total += SQRT(square);
            squares += square;
            if (square > largest) largest = square, farthest = vertex;
        }
        const double row[5] = {(double)known, total, known ? sqrt((double)largest) : 0, (double)farthest, squares};
        memcpy(results + 5 * frame, row, sizeof row);
    }
    return 0;
}

/* A row of riginv.networks.distance_weights: displacements at one[axis * jump + cluster * step]. */
static inline void NAME(weighted_row)(const REAL *one, Index jump, Index step, const REAL *counts, Index clusters, REAL least,
                                      REAL *error, REAL *distance, REAL *mean) {
    REAL count = 0, sum = 0, total = 0;
#pragma omp simd reduction(+ : count, sum)
    for (Index k = 0; k < clusters; k++) {
        const REAL x = one[k * step], y = one[jump + k * step], z = one[2 * jump + k * step];
        count += counts[k];
        sum += counts[k] * SQRT(x * x + y * y + z * z);
    }
    *mean = sum / count;
    const REAL smallest = least * *mean * (least * *mean) + SMALLEST;
#pragma omp simd reduction(+ : total)
    for (Index k = 0; k < clusters; k++) {
        const REAL x = one[k * step], y = one[jump + k * step], z = one[2 * jump + k * step];
        const REAL rounded = SQRT(x * x + y * y + z * z + smallest), weight = counts[k] * *mean / rounded;
        total += counts[k] * rounded;
        error[k * step] = weight * x;
        error[jump + k * step] = weight * y;
        error[2 * jump + k * step] = weight * z;
    }
    *distance = total / count;
}

/* DistanceWeights of displacements (batch, 3, cluster), or (batch, cluster, 3) where `interleaved`: the weighted error, laid out
 * alike, and results (2, batch), the rounded mean distance and the mean distance. counts (cluster,), least (1,).
 */
API int NAME(weighted_distances)(const REAL *displacements, Index interleaved, const REAL *counts, Index clusters, const REAL *least,
                                 REAL *error, REAL *results, Index batch) {
    for (Index row = 0; row < batch; row++, displacements += 3 * clusters, error += 3 * clusters) {
        REAL *distance = results + row, *mean = results + batch + row;
        if (interleaved)
            NAME(weighted_row)(displacements, 1, 3, counts, clusters, *least, error, distance, mean);
        else
            NAME(weighted_row)(displacements, clusters, 1, counts, clusters, *least, error, distance, mean);
    }
    return 0;
}
