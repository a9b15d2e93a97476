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
