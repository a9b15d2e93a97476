"use strict";
const GREY = [110, 110, 110], CLAY = [214, 178, 158], RED = [217, 26, 26];
// Target, a mesh or a scan, and recovered mesh by WebGL2, under one camera: smooth normals, three lights, errors as heat.
function makeScene(canvas, faces, colors, facts, scanBytes) {
  const gl = canvas.getContext("webgl2", { antialias: true, alpha: true, premultipliedAlpha: true, preserveDrawingBuffer: true });
  if (!gl) throw new Error("it is not there, or switched off");
  const count = facts.vertices, edges = edgesOf(faces);
  const sides = ["target", "recovered"].map(() => ({
    position: new Float32Array(3 * count), normal: new Float32Array(3 * count), color: new Uint8Array(3 * count),
  }));
  const program = link(gl, `#version 300 es
    in vec3 position; in vec3 normal; in vec3 color; uniform mat4 view; uniform mat4 projection; uniform float nearer;
    out vec3 side; out vec3 paint; out vec3 place;
    void main() { vec4 seen = view * vec4(position, 1.0); side = mat3(view) * normal; paint = color; place = seen.xyz;
      gl_Position = projection * seen; gl_Position.z -= nearer * gl_Position.w; gl_PointSize = 4.0; }`, `#version 300 es
    precision highp float; in vec3 side; in vec3 paint; in vec3 place; uniform float wire; out vec4 pixel;
    float lit(vec3 n, vec3 from) { return max(dot(n, normalize(from)), 0.0); }
    void main() {
      if (wire > 0.5) { pixel = vec4(0.0, 0.0, 0.0, 0.28); return; }
      vec3 n = normalize(side); if (!gl_FrontFacing) n = -0.6 * n;
      vec3 base = pow(paint, vec3(2.2));
      float key = lit(n, vec3(-0.45, 0.55, 0.75)), fill = lit(n, vec3(0.7, 0.1, 0.5)), rim = lit(n, vec3(0.0, 0.6, -0.6));
      vec3 shine = vec3(pow(lit(n, normalize(vec3(-0.45, 0.55, 0.75)) + vec3(0.0, 0.0, 1.0)), 28.0)) * 0.10;
      vec3 light = base * (0.16 + 0.78 * key + 0.26 * fill + 0.25 * rim) + shine;
      pixel = vec4(pow(clamp(light, 0.0, 1.0), vec3(1.0 / 2.2)), 1.0); }`);
  const buffers = Object.fromEntries(["position", "normal", "color"].map((name) => [name, gl.createBuffer()]));
  const faceBuffer = indexBuffer(gl, faces), edgeBuffer = indexBuffer(gl, edges), scanBuffer = gl.createBuffer();
  const scans = scanBytes && scansOf(scanBytes, facts);
  const camera = {};
  let moved = () => {}, shown = null;
  reset();

  function reset() { Object.assign(camera, { turn: 0.3, tilt: 0.06, away: 3.7 * facts.radius, x: 0, y: 0.05 * facts.radius }); }

  // Put both meshes between two kept frames, each `target, recovered` in `meshes`; a scan is that of the nearer frame.
  function pose(meshes, first, second, part, state) {
    const [target, recovered] = sides, { step } = facts, width = 3 * count, missing = -32768;
    const one = first * 2 * width, other = second * 2 * width;
    const paint = recovered.color, plain = target.color;
    for (let v = 0; v < count; v++) {
      let square = 0, unknown = false;
      for (let axis = 0; axis < 3; axis++) {
        const i = 3 * v + axis, b = meshes[one + width + i], d = meshes[other + width + i];
        const a = meshes[one + i], c = meshes[other + i];
        recovered.position[i] = (b + (d - b) * part) * step;
        unknown ||= a === missing || c === missing;
        target.position[i] = unknown ? recovered.position[i] : (a + (c - a) * part) * step;
        square += (target.position[i] - recovered.position[i]) ** 2;
      }
      const hot = unknown ? GREY : state.heat && hotter(Math.sqrt(square), state.top);
      for (let axis = 0; axis < 3; axis++) {
        const clay = colors ? colors[3 * v + axis] : CLAY[axis];
        plain[3 * v + axis] = unknown ? GREY[axis] : clay;
        paint[3 * v + axis] = state.heat ? hot[axis] : clay;
      }
    }
    for (const side of sides) normals(side);
    if (scans) shown = scanAt(scans[part < 0.5 ? first : second], state);
  }

  function hotter(distance, top) { // the colour of a distance
    const { heat } = facts, place = Math.min(distance / top, 1) * (heat.length - 1), stop = Math.min(Math.floor(place), heat.length - 2);
    return [0, 1, 2].map((axis) => heat[stop][axis] + (heat[stop + 1][axis] - heat[stop][axis]) * (place - stop));
  }

  function scanAt(scan, state) {
    const color = new Uint8Array(scan.position.length);
    for (let v = 0; v < scan.distance.length; v++) {
      const beyond = scan.distance[v] === 65535, plain = v < scan.distance.length - scan.balls ? CLAY : RED;
      color.set(!state.heat ? plain : beyond ? GREY : hotter(scan.distance[v] * facts.step, state.top), 3 * v);
    }
    return { position: Float32Array.from(scan.position, (x) => x * facts.step), normal: Float32Array.from(scan.normal), color, faces: scan.faces };
  }

  function normals({ position: p, normal: n }) {
    n.fill(0);
    for (let f = 0; f < faces.length; f += 3) {
      const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
      const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
      const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
      const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
      for (const i of [a, b, c]) { n[i] += x; n[i + 1] += y; n[i + 2] += z; }
    }
  }

  function draw(state) {
    const ratio = devicePixelRatio || 1, w = Math.round(canvas.clientWidth * ratio), h = Math.round(canvas.clientHeight * ratio);
    if (canvas.width !== w || canvas.height !== h) { canvas.width = w; canvas.height = h; }
    gl.enable(gl.DEPTH_TEST); gl.enable(gl.BLEND); gl.blendFuncSeparate(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA, gl.ONE, gl.ONE);
    gl.clearColor(0, 0, 0, 0); gl.viewport(0, 0, w, h); gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    gl.useProgram(program);
    const panes = state.show === "both" ? [[0, 0, w / 2], [1, w / 2, w / 2]] : [[state.show === "target" ? 0 : 1, 0, w]];
    for (const [number, left, wide] of panes) {
      gl.viewport(left, 0, wide, h);
      for (const name of ["position", "normal", "color"]) {
        const place = gl.getAttribLocation(program, name), bytes = name === "color";
        gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
        gl.bufferData(gl.ARRAY_BUFFER, (number === 0 && shown || sides[number])[name], gl.DYNAMIC_DRAW);
        gl.enableVertexAttribArray(place);
        gl.vertexAttribPointer(place, 3, bytes ? gl.UNSIGNED_BYTE : gl.FLOAT, bytes, 0, 0);
      }
      uniform("view", viewMatrix()); uniform("projection", projection(wide / h));
      if (number === 0 && shown) { paintScan(); continue; }
      paint(faceBuffer, gl.TRIANGLES, faces.length, 0, 0);
      if (state.wires) paint(edgeBuffer, gl.LINES, edges.length, 1, 2e-4);
    }
  }

  function paint(buffer, mode, length, wire, nearer) {
    gl.uniform1f(gl.getUniformLocation(program, "wire"), wire);
    gl.uniform1f(gl.getUniformLocation(program, "nearer"), nearer);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
    gl.drawElements(mode, length, gl.UNSIGNED_INT, 0);
  }
  function paintScan() { // a point cloud as points
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, scanBuffer);
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, shown.faces, gl.DYNAMIC_DRAW);
    gl.uniform1f(gl.getUniformLocation(program, "wire"), 0);
    gl.uniform1f(gl.getUniformLocation(program, "nearer"), 0);
    if (shown.faces.length) gl.drawElements(gl.TRIANGLES, shown.faces.length, gl.UNSIGNED_SHORT, 0);
    else gl.drawArrays(gl.POINTS, 0, shown.position.length / 3);
  }
  function uniform(name, matrix) { gl.uniformMatrix4fv(gl.getUniformLocation(program, name), false, matrix); }

  function viewMatrix() { // column by column; the middle of the meshes is the origin
    const c = Math.cos(camera.turn), s = Math.sin(camera.turn), d = Math.cos(camera.tilt), t = Math.sin(camera.tilt);
    return [c, s * t, -s * d, 0, 0, d, t, 0, s, -c * t, c * d, 0, camera.x, camera.y, -camera.away, 1];
  }
  function projection(aspect) {
    const near = camera.away / 50, far = camera.away + 8 * facts.radius, focal = 3.2 * Math.min(1, aspect * 1.15);
    return [focal / aspect, 0, 0, 0, 0, focal, 0, 0, 0, 0, (far + near) / (near - far), -1, 0, 0, 2 * far * near / (near - far), 0];
  }

  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    if (event.shiftKey || event.buttons > 1) {
      const scale = camera.away / canvas.clientHeight / 1.6;
      camera.x += event.movementX * scale; camera.y -= event.movementY * scale;
    } else {
      camera.turn += event.movementX * 0.008;
      camera.tilt = Math.min(Math.max(camera.tilt + event.movementY * 0.008, -1.5), 1.5);
    }
    moved();
  });
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    camera.away = Math.min(Math.max(camera.away * Math.exp(event.deltaY * 0.001), 0.3 * facts.radius), 40 * facts.radius);
    moved();
  }, { passive: false });
  return { pose, draw, reset, onMove: (act) => { moved = act; } };
}

// The scans as riginv/tracking/viewer/scans.py packs them: all positions, distances, faces, normals.
function scansOf(bytes, { scans }) {
  const points = scans.reduce((sum, [count]) => sum + count, 0), triangles = scans.reduce((sum, [, count]) => sum + count, 0);
  const starts = [0, 6 * points, 8 * points, 8 * points + 6 * triangles];
  const position = new Int16Array(bytes.buffer, starts[0], 3 * points), distance = new Uint16Array(bytes.buffer, starts[1], points);
  const corners = new Uint16Array(bytes.buffer, starts[2], 3 * triangles), normal = new Int8Array(bytes.buffer, starts[3], 3 * points);
  let p = 0, f = 0;
  return scans.map(([count, faces, balls]) => {
    const [from, to, first] = [p, p + count, f];
    p = to; f += faces;
    return { balls, position: position.subarray(3 * from, 3 * to), normal: normal.subarray(3 * from, 3 * to),
      distance: distance.subarray(from, to), faces: corners.subarray(3 * first, 3 * f) };
  });
}

function edgesOf(faces) {
  const seen = new Set(), edges = [];
  for (let f = 0; f < faces.length; f += 3) for (let k = 0; k < 3; k++) {
    const a = faces[f + k], b = faces[f + (k + 1) % 3], key = Math.min(a, b) * 4294967296 + Math.max(a, b);
    if (!seen.has(key)) { seen.add(key); edges.push(a, b); }
  }
  return new Uint32Array(edges);
}

function indexBuffer(gl, indices) {
  const buffer = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffer);
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, indices, gl.STATIC_DRAW);
  return buffer;
}

function link(gl, vertex, fragment) {
  const program = gl.createProgram();
  for (const [kind, source] of [[gl.VERTEX_SHADER, vertex], [gl.FRAGMENT_SHADER, fragment]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, source); gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  return program;
}
