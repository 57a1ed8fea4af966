// Interactive 3D view of a scene in WebGL, without libraries or network. The page contains the scene as JSON.
"use strict";
(() => {
  const canvas = document.getElementById("scene-3d");
  const controls = document.getElementById("scene-3d-controls");
  const gl = canvas.getContext("webgl2", {antialias: true, preserveDrawingBuffer: true});
  if (!gl) { controls.textContent = "This browser does not support WebGL."; return; }
  const scene = JSON.parse(document.getElementById("scene-3d-data").textContent);

  const bytes = text => Uint8Array.from(atob(text), c => c.charCodeAt(0));
  const VERTEX = `#version 300 es
    layout(location = 0) in vec3 place; layout(location = 1) in vec3 normal;
    uniform mat4 view, world; uniform vec3 low, span; out vec3 n, at;
    void main() {
      vec4 p = world * vec4(low + place * span, 1.0);
      at = p.xyz; n = mat3(world) * normal; gl_Position = view * p;
    }`;
  const FRAGMENT = `#version 300 es
    precision highp float; in vec3 n, at; uniform vec4 rgba; uniform vec3 eye; out vec4 colour;
    void main() {
      vec3 m = normalize(n), v = normalize(eye - at);
      if (dot(m, v) < 0.0) m = -m;
      float sky = 0.5 + 0.5 * m.z, sun = max(dot(m, normalize(vec3(-0.4, 0.35, 0.85))), 0.0);
      vec3 light = rgba.rgb * (0.35 + 0.3 * sky + 0.45 * sun);
      colour = vec4(pow(light, vec3(1.0 / 1.1)), rgba.a);
    }`;
  const shader = (kind, text) => {
    const compiled = gl.createShader(kind);
    gl.shaderSource(compiled, text); gl.compileShader(compiled);
    if (!gl.getShaderParameter(compiled, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(compiled));
    return compiled;
  };
  const program = gl.createProgram();
  gl.attachShader(program, shader(gl.VERTEX_SHADER, VERTEX));
  gl.attachShader(program, shader(gl.FRAGMENT_SHADER, FRAGMENT));
  gl.linkProgram(program); gl.useProgram(program);
  const uniforms = Object.fromEntries(["view", "world", "low", "span", "rgba", "eye"]
    .map(name => [name, gl.getUniformLocation(program, name)]));

  // Meshes: positions as fractions of the bounding box (uint16), normals (int8), triangles (uint32).
  for (const object of scene.objects) for (const part of object.parts) for (const mesh of part) {
    mesh.vao = gl.createVertexArray();
    gl.bindVertexArray(mesh.vao);
    const fill = (slot, data, type) => {
      gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
      gl.bufferData(gl.ARRAY_BUFFER, data, gl.STATIC_DRAW);
      gl.enableVertexAttribArray(slot);
      gl.vertexAttribPointer(slot, 3, type, true, type === gl.BYTE ? 4 : 8, 0);
    };
    fill(0, bytes(mesh.places), gl.UNSIGNED_SHORT);
    fill(1, bytes(mesh.normals), gl.BYTE);
    const faces = bytes(mesh.faces);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STATIC_DRAW);
    mesh.count = faces.length / 4;
  }

  // Poses: a row-major 3x3 rotation r and a position p.
  const mul = (a, b) => a.map((_, k) => a[3 * Math.floor(k / 3)] * b[k % 3]
    + a[3 * Math.floor(k / 3) + 1] * b[3 + k % 3] + a[3 * Math.floor(k / 3) + 2] * b[6 + k % 3]);
  const rotate = (r, p) => [0, 3, 6].map(k => r[k] * p[0] + r[k + 1] * p[1] + r[k + 2] * p[2]);
  const plus = (a, b) => a.map((v, k) => v + b[k]), minus = (a, b) => a.map((v, k) => v - b[k]);
  const scaled = (a, f) => a.map(v => v * f);
  const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
  const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2],
    a[0] * b[1] - a[1] * b[0]];
  const unit = a => scaled(a, 1 / (Math.hypot(...a) || 1));
  const then = (a, b) => ({r: mul(a.r, b.r), p: plus(a.p, rotate(a.r, b.p))});
  const IDENTITY = {r: [1, 0, 0, 0, 1, 0, 0, 0, 1], p: [0, 0, 0]};
  const rotation = (axis, angle) => {
    const [x, y, z] = unit(axis), c = Math.cos(angle), s = Math.sin(angle), d = 1 - c;
    return [c + x * x * d, x * y * d - z * s, x * z * d + y * s,
      y * x * d + z * s, c + y * y * d, y * z * d - x * s,
      z * x * d - y * s, z * y * d + x * s, c + z * z * d];
  };
  const motion = (joint, values) => {
    if (joint.type === "prismatic") return {r: IDENTITY.r, p: scaled(joint.axis, values[0])};
    const ball = joint.type === "ball";
    const angle = ball ? Math.hypot(...values) : values[0];
    if (joint.type === "fixed" || !angle) return IDENTITY;
    const r = rotation(ball ? values : joint.axis, angle);
    return {r, p: minus(joint.pos, rotate(r, joint.pos))};
  };
  const jointValues = (object, joint) => {
    let factor = 1, offset = 0;
    for (let k = 0; joint.mimic && k <= object.joints.length; k++) {
      offset += factor * joint.mimic.offset; factor *= joint.mimic.multiplier;
      joint = object.joints[joint.mimic.joint];
    }
    return joint.values.map(v => factor * v + offset);
  };
  const links = object => {
    const moved = object.parts.map(() => null);
    for (const k of object.order) {
      const joint = object.joints[object.by[k]];
      moved[k] = joint === undefined ? IDENTITY
        : then(moved[joint.parent], motion(joint, jointValues(object, joint)));
    }
    return moved.map(link => then(object.pose, link));
  };

  // Orbit camera: azimuth and elevation (drag) and distance (wheel or pinch) about a center.
  const eye = {...scene.eye};
  let shown = -1, waiting = false;
  const frame = k => {
    shown = k;
    const view = k < 0 ? scene.eye : scene.objects[k].eye;
    Object.assign(eye, {...view, middle: [...view.middle]});
    draw();
  };
  const look = () => {
    const c = Math.cos(eye.elevation);
    const away = [c * Math.cos(eye.azimuth), c * Math.sin(eye.azimuth), Math.sin(eye.elevation)];
    const from = plus(eye.middle, scaled(away, eye.distance));
    const back = unit(away), right = unit(cross([0, 0, 1], back)), up = cross(back, right);
    return {from, back, right, up};
  };
  const draw = () => {
    if (waiting) return;
    waiting = true;
    requestAnimationFrame(() => { waiting = false; paint(); });
  };
  const paint = () => {
    const width = canvas.clientWidth * devicePixelRatio, height = canvas.clientHeight * devicePixelRatio;
    if (canvas.width !== Math.round(width) || canvas.height !== Math.round(height)) {
      canvas.width = Math.round(width); canvas.height = Math.round(height);
    }
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(0.86, 0.88, 0.9, 1); gl.enable(gl.DEPTH_TEST); gl.depthMask(true);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const {from, back, right, up} = look();
    const f = 1 / Math.tan(eye.fovy / 2), aspect = canvas.width / canvas.height;
    const near = Math.max(eye.distance / 200, 1e-3), far = eye.distance * 20 + 50;
    const a = (far + near) / (near - far), b = 2 * far * near / (near - far);
    const t = [-dot(right, from), -dot(up, from), -dot(back, from)];
    const view = new Float32Array([0, 1, 2].flatMap(k =>
      [f / aspect * right[k], f * up[k], a * back[k], -back[k]])
      .concat([f / aspect * t[0], f * t[1], a * t[2] + b, -t[2]]));
    gl.uniformMatrix4fv(uniforms.view, false, view);
    gl.uniform3fv(uniforms.eye, from);
    for (const transparent of [false, true]) {
      (transparent ? gl.enable : gl.disable).call(gl, gl.BLEND);
      gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
      gl.depthMask(!transparent);
      scene.objects.forEach((object, k) => {
        if (shown >= 0 && k !== shown) return;
        const poses = links(object);
        object.parts.forEach((meshes, part) => {
          const {r, p} = poses[part];
          gl.uniformMatrix4fv(uniforms.world, false,
            [r[0], r[3], r[6], 0, r[1], r[4], r[7], 0, r[2], r[5], r[8], 0, ...p, 1]);
          for (const mesh of meshes) {
            if (mesh.rgba[3] < 1 !== transparent) continue;
            gl.uniform3fv(uniforms.low, mesh.low); gl.uniform3fv(uniforms.span, mesh.span);
            gl.uniform4fv(uniforms.rgba, mesh.rgba);
            gl.bindVertexArray(mesh.vao);
            gl.drawElements(gl.TRIANGLES, mesh.count, gl.UNSIGNED_INT, 0);
          }
        });
      });
    }
  };

  // Pointers: drag rotates; Shift, the right button or two fingers pan; a pinch zooms.
  const pointers = new Map();
  const zoom = factor => {
    eye.distance = Math.min(Math.max(eye.distance * factor, 0.02), 200); draw();
  };
  const shift = (dx, dy) => {
    const {right, up} = look(), k = 2 * eye.distance * Math.tan(eye.fovy / 2) / canvas.clientHeight;
    eye.middle = plus(eye.middle, plus(scaled(right, -dx * k), scaled(up, dy * k)));
  };
  canvas.addEventListener("pointerdown", event => {
    canvas.setPointerCapture(event.pointerId);
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
  });
  for (const name of ["pointerup", "pointercancel"])
    canvas.addEventListener(name, event => pointers.delete(event.pointerId));
  canvas.addEventListener("pointermove", event => {
    const before = pointers.get(event.pointerId);
    if (!before) return;
    const spread = () => {
      const [p, q] = [...pointers.values()];
      return Math.hypot(p[0] - q[0], p[1] - q[1]);
    };
    const dx = event.clientX - before[0], dy = event.clientY - before[1];
    const two = pointers.size === 2, old = two ? spread() : 1;
    pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (two) { shift(dx / 2, dy / 2); zoom(old / (spread() || 1)); }
    else if (event.shiftKey || event.buttons === 2) shift(dx, dy);
    else {
      eye.azimuth -= dx * 0.008;
      eye.elevation = Math.min(Math.max(eye.elevation + dy * 0.008, -1.5), 1.5);
    }
    draw();
  });
  canvas.addEventListener("wheel", event => {
    event.preventDefault(); zoom(Math.exp(event.deltaY * 0.001));
  }, {passive: false});
  canvas.addEventListener("contextmenu", event => event.preventDefault());
  canvas.addEventListener("dblclick", () => frame(shown));
  addEventListener("resize", draw);

  // Controls: a selector for the object to show, and a slider for each joint that mimics no other joint.
  const choice = document.createElement("select");
  choice.setAttribute("aria-label", "Shown");
  ["the whole scene", ...scene.objects.map(object => object.name)].forEach((name, k) =>
    choice.append(new Option(name, k - 1)));
  choice.addEventListener("change", () => {
    frame(Number(choice.value));
    for (const row of controls.querySelectorAll("label"))
      row.hidden = shown >= 0 && Number(row.dataset.object) !== shown;
  });
  controls.append(choice);
  scene.objects.forEach((object, k) => object.joints.forEach(joint => {
    if (joint.type === "fixed" || joint.mimic) return;
    joint.values.forEach((value, axis) => {
      const row = document.createElement("label"), slider = document.createElement("input");
      row.dataset.object = k;
      const tail = joint.values.length > 1 ? " " + "xyz"[axis] : "";
      row.append(`${object.name}: ${joint.name}${tail}`, slider);
      Object.assign(slider, {type: "range", min: joint.low, max: joint.high, step: "any", value});
      slider.addEventListener("input", () => { joint.values[axis] = Number(slider.value); draw(); });
      controls.append(row);
    });
  }));
  frame(-1);
})();
