/* riginv.networks.packed, refinement: what a refinement step does between its matrix products; in float32 alone. */

/* tanh and erf as quotients of polynomials (those of Eigen), which vectorise; a few units in the last place from the C library's. */
static inline float quick_tanh(float x) {
    x = x < -7.90531111f ? -7.90531111f : x > 7.90531111f ? 7.90531111f : x;
    const float s = x * x;
    float over = s * -2.76076847742355e-16f + 2.00018790482477e-13f;
    over = over * s - 8.60467152213735e-11f;
    over = over * s + 5.12229709037114e-08f;
    over = over * s + 1.48572235717979e-05f;
    over = over * s + 6.37261928875436e-04f;
    over = (over * s + 4.89352455891786e-03f) * x;
    float under = s * 1.19825839466702e-06f + 1.18534705686654e-04f;
    under = under * s + 2.26843463243900e-03f;
    return over / (under * s + 4.89352518554385e-03f);
}

static inline float quick_erf(float x) {
    x = x < -4 ? -4 : x > 4 ? 4 : x;
    const float s = x * x;
    float over = s * -2.72614225801306e-10f + 2.77068142495902e-08f;
    over = over * s - 2.10102402082508e-06f;
    over = over * s - 5.69250639462346e-05f;
    over = over * s - 7.34990630326855e-04f;
    over = over * s - 2.95459980854025e-03f;
    over = (over * s - 1.60960333262415e-02f) * x;
    float under = s * -1.45660718464996e-05f - 2.13374055278905e-04f;
    under = under * s - 1.68282697438203e-03f;
    under = under * s - 7.37332916720468e-03f;
    return over / (under * s - 1.42647390514189e-02f);
}

/* values (number,) <- their GELU. */
API int gelu_f32(float *values, Index numbers) {
    for (Index number = 0; number < numbers; number++)
        values[number] = 0.5f * values[number] * (1 + quick_erf(values[number] * 0.707106781f));
    return 0;
}

/* raw (batch, control) to controls by NeutralStart, and the derivative of each, both (batch, control). map (8, control): direction,
 * depth, edge, norm, least, above, below, neutral.
 */
API int neutral_start_f32(const float *raw, const float *map, Index controls, float *result, float *derivatives, Index batch) {
    const float *direction = map, *depth = direction + controls, *edge = depth + controls, *norm = edge + controls;
    const float *least = norm + controls, *above = least + controls, *below = above + controls, *neutral = below + controls;
    for (Index row = 0; row < batch; row++, raw += controls, result += controls, derivatives += controls)
        for (Index control = 0; control < controls; control++) {
            const float tail = quick_tanh(direction[control] * raw[control] - depth[control]);
            const float scale = raw[control] >= 0 ? above[control] : below[control];
            const float moved = (tail + edge[control]) / norm[control], most = least[control];
            result[control] = neutral[control] + scale * (moved < most ? most : moved);
            derivatives[control] = scale / norm[control] * (1 - tail * tail) * direction[control];
        }
    return 0;
}

/* The inputs of a refinement step from raw (batch, control): the scaled gradient by the raw outputs goes to the end of each row of
 * linear (batch, size + control); gate (batch, 2 control + 1) becomes the squashed raw outputs, the gradient's direction and the
 * scaled logarithm of its size. gradients (batch, control) are by the controls, derivatives those of the controls by the raw
 * outputs; NULL: gradients are by these already. scales (3,): by which the gradient is divided, the least size, that of the
 * logarithm.
 */
API int refinement_inputs_f32(const float *raw, const float *gradients, const float *derivatives, const float *scales,
                              Index controls, float *linear, Index size, float *gate, Index batch) {
    for (Index row = 0; row < batch; row++, raw += controls, gradients += controls) {
        float *gradient = linear + row * (size + controls) + size, *squashed = gate + row * (2 * controls + 1);
        float *direction = squashed + controls;
        double squares = 0;
        for (Index control = 0; control < controls; control++) {
            gradient[control] = gradients[control] * (derivatives ? derivatives[row * controls + control] : 1) / scales[0];
            squashed[control] = quick_tanh(0.3f * raw[control]);
        }
        for (Index control = 0; control < controls; control++) squares += (double)gradient[control] * (double)gradient[control];
        const double length = sqrt(squares / (double)controls) + scales[1];
        for (Index control = 0; control < controls; control++) direction[control] = gradient[control] / (float)length;
        direction[controls] = (float)(scales[2] * log(length));
    }
    return 0;
}
