// 3D replays of episodes on 2D canvases; `replay.py` describes the data. Lengths are in metres, angles in radians.
// Painter's order is exact for a robot among walls: everything stands on the floor and below the tops of the walls, and
// the eye is above them. So the tops, drawn last, hide what is behind them; the plane of a side tells what it hides.
const [WALL_TOP, OBSTACLE_TOP, BASE_TOP, ROBOT_TOP, LABEL_HEIGHT, GOAL_RADIUS] = [0.5, 0.45, 0.13, 0.34, 0.5, 0.2];
const FOCAL = 2, NEAREST = 0.1, LOWEST = 0.8, STEEPEST = Math.PI / 2 - 1e-3; // of the eye; [canvas heights] and limits
const VIEWS = { // direction of the eye from the middle of the world, or with a distance from the robot
  overview: { azimuth: -Math.PI / 2 - 0.2, elevation: 0.95, zoom: 1 },
  above: { azimuth: -Math.PI / 2, elevation: STEEPEST, zoom: 1 },
  chase: { azimuth: Math.PI, elevation: 0.5, zoom: 1, distance: 5 },
};
const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const mix = (a, b, share) => a + share * (b - a);
const mixAngles = (a, b, share) => a + share * Math.atan2(Math.sin(b - a), Math.cos(b - a));
const mixPoses = (one, other, share) => one.map((a, k) => (k < 2 ? mix : mixAngles)(a, other[k], share));
const mixPoints = ([p, q], share) => p.map((a, k) => mix(a, q[k], share));
const thousandths = (value) => (Array.isArray(value) ? value.map(thousandths) : value && value / 1000);
const raised = (points, z) => points.map(([x, y]) => [x, y, z]);
const edges = (ring) => ring.map((p, i) => [p, ring[(i + 1) % ring.length]]);
const length = ([p, q]) => Math.hypot(q[0] - p[0], q[1] - p[1]);
const facing = ([p, q], [x, y]) => (x - p[0]) * (q[1] - p[1]) + (y - p[1]) * (p[0] - q[0]) > 0;
const rectangle = ([x0, y0, x1, y1]) => [[x0, y0], [x1, y0], [x1, y1], [x0, y1]];
const polar = (range, angle) => [range * Math.cos(angle), range * Math.sin(angle)];
const placed = (points, [x, y, yaw]) => points.map(([ahead, left]) =>
  [x + ahead * Math.cos(yaw) - left * Math.sin(yaw), y + ahead * Math.sin(yaw) + left * Math.cos(yaw)]);
const circle = ([x, y], radius, corners = 28) =>
  placed(Array.from({ length: corners }, (_, i) => polar(radius, (2 * Math.PI * i) / corners)), [x, y, 0]);
const pieces = (side) => // of at most 1 m, because the middles of sides decide their order
  Array.from({ length: Math.ceil(length(side)) }, (_, i, n = Math.ceil(length(side))) =>
    [mixPoints(side, i / n), mixPoints(side, (i + 1) / n)]);

function perspective({ target, azimuth, elevation, distance }, width, height) {
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  const eye = [target[0] + distance * ce * ca, target[1] + distance * ce * sa, distance * se], focal = FOCAL * height;
  const seen = ([x, y, z]) => { // to the right, up and ahead
    const [dx, dy, dz] = [x - eye[0], y - eye[1], z - eye[2]], outward = ca * dx + sa * dy;
    return [ca * dy - sa * dx, ce * dz - se * outward, -ce * outward - se * dz];
  };
  const pixels = (points, closed = true) => points.map(seen).flatMap((p, i, all) => { // without what is behind the eye
    const q = all[i + 1] ?? (closed ? all[0] : p), isSeen = p[2] >= NEAREST;
    const crossing = isSeen === q[2] >= NEAREST ? [] : [mixPoints([p, q], (NEAREST - p[2]) / (q[2] - p[2]))];
    return isSeen ? [p, ...crossing] : crossing;
  }).map(([x, y, depth]) => [width / 2 + focal * x / depth, height / 2 - focal * y / depth]);
  return { eye, pixels, depth: ([x, y]) => seen([x, y, 0])[2], scale: focal / distance }; // scale: [px/m] at the target
}

function show(figure) {
  const data = JSON.parse(figure.querySelector("script").textContent), { times, texts } = data, end = times.at(-1);
  const { poses, angles, shapes, obstacles, bounds, radius, goal, posts, walls: boxes } =
    Object.fromEntries(Object.entries(data).map(([name, value]) => [name, thousandths(value)]));
  const walls = [...boxes, ...posts.map((post) => [circle(post, post[2], 16)])], style = getComputedStyle(figure);
  const sides = walls.flat().flatMap(edges).flatMap(pieces);
  const canvas = figure.querySelector("canvas"), context = canvas.getContext("2d"), pointers = new Map();
  const [button, slider, speed, view] = figure.querySelector(".replay-controls").children;
  const colour = (name) => (colours[name] ??= style.getPropertyValue(`--replay-${name}`).trim());
  let time = 0, isPlaying = false, camera = { ...VIEWS.overview }, colours, scene; // `scene` is the perspective

  function trace(rings) {
    context.beginPath();
    for (const ring of rings) ring.forEach(([x, y], i) => (i ? context.lineTo(x, y) : context.moveTo(x, y)));
  }
  function stroke(pixels, name, width) {
    Object.assign(context, { strokeStyle: colour(name), lineWidth: width });
    trace([pixels]);
    context.stroke();
  }
  function line(points, name, width, alpha = 1) {
    context.globalAlpha = alpha;
    stroke(scene.pixels(raised(points, 0), false), name, width);
    context.globalAlpha = 1;
  }
  function fill(rings, name, light = 1) { // the further rings are holes
    const shade = [1, 3, 5].map((i) => Math.min(255, light * parseInt(colour(name).slice(i, i + 2), 16)));
    Object.assign(context, { fillStyle: `rgb(${shade})`, strokeStyle: `rgb(${shade})`, lineWidth: 0.7 });
    trace(rings.map((ring) => scene.pixels(ring)));
    context.fill("evenodd");
    if (context.globalAlpha === 1) context.stroke(); // closes gaps between neighbours
  }
  function fillSide([p, q], bottom, top, name) { // the light comes from one direction
    const light = 0.78 + (0.08 * (q[1] - p[1]) + 0.14 * (q[0] - p[0])) / length([p, q]);
    fill([[...raised([p, q], bottom), ...raised([q, p], top)]], name, light);
  }
  function prism(ring, bottom, top, name) {
    for (const side of edges(ring)) if (facing(side, scene.eye)) fillSide(side, bottom, top, name);
    fill([raised(ring, top)], name, 1.1);
  }
  function write(text, [x, y], name) {
    Object.assign(context, { font: "600 13px system-ui, sans-serif", textAlign: "center", lineWidth: 4 });
    Object.assign(context, { strokeStyle: colour("sky"), fillStyle: colour(name) });
    for (const method of ["strokeText", "fillText"]) context[method](text, x, y - 9);
  }

  function drawFloor(pose, driven, hits) {
    const [x0, y0, x1, y1] = bounds, step = Math.max(x1 - x0, y1 - y0) > 60 ? 10 : 1;
    context.save();
    fill([raised(rectangle(bounds), 0)], "floor");
    context.clip();
    for (let x = Math.ceil(x0 / step) * step; x <= x1; x += step) line([[x, y0], [x, y1]], "grid", 1);
    for (let y = Math.ceil(y0 / step) * step; y <= y1; y += step) line([[x0, y], [x1, y]], "grid", 1);
    for (const hit of hits) line([pose, hit], "beam", 1, 0.6);
    for (const hit of hits) fill([raised(circle(hit, 0.05, 8), 0)], "beam");
    line(poses, "path", 1, 0.6);
    line([...driven, pose], "path", 3);
    for (const edge of edges(circle(poses[0], radius))) line(edge, "start", 2.5);
    for (const edge of goal ? edges(circle(goal, GOAL_RADIUS)) : []) line(edge, "goal", 2.5);
    context.restore();
  }
  function drawRobot(pose) { // a base, a plate above it, and a wedge that points ahead
    const wedge = [[0.75, 0], [-0.45, 0.55], [-0.2, 0], [-0.45, -0.55]].map((point) => point.map((a) => a * radius));
    prism(circle(pose, radius), 0.02, BASE_TOP, "body");
    prism(circle(pose, 0.85 * radius), 0.2, ROBOT_TOP, "plate");
    fill([raised(placed(wedge, pose), ROBOT_TOP)], "nose");
  }
  function drawStanding(things) { // each after the sides that it is in front of
    const byDepth = (point) => (one, other) => scene.depth(point(other)) - scene.depth(point(one));
    let sidesLeft = sides.filter((side) => facing(side, scene.eye)).sort(byDepth((side) => mixPoints(side, 0.5)));
    for (const { at, draw } of [...things.sort(byDepth((thing) => thing.at)), {}]) {
      const isBehind = (side) => !at || facing(side, at);
      for (const side of sidesLeft.filter(isBehind)) fillSide(side, 0, WALL_TOP, "wall");
      sidesLeft = sidesLeft.filter((side) => !isBehind(side));
      draw?.();
    }
    for (const rings of walls) fill(rings.map((ring) => raised(ring, WALL_TOP)), "wall", 1.18);
  }
  function look(pose, width, height) { // at the middle of the world; zooming in moves from there to the robot
    const { azimuth, elevation, zoom, distance } = camera, nearness = distance ? 1 : clamp(1.4 * (1 - zoom), 0, 1);
    const target = mixPoints([mixPoints([bounds.slice(0, 2), bounds.slice(2)], 0.5), pose], nearness);
    const whole = 0.87 * FOCAL * length([bounds.slice(0, 2), bounds.slice(2)]) * Math.max(height / width, 1);
    const far = Math.max((distance ?? whole) * zoom, 1.2), high = Math.max(elevation, Math.asin(LOWEST / far));
    const direction = { azimuth: azimuth + (distance ? pose[2] : 0), elevation: high };
    return perspective({ target, ...direction, distance: far }, width, height);
  }
  const state = () => times.findLastIndex((each) => each <= time + 1e-6);
  function draw() {
    const { clientWidth: width, clientHeight: height } = canvas, i = state(), next = Math.min(i + 1, poses.length - 1);
    const share = next > i ? (time - times[i]) / (times[next] - times[i]) : 0, isOver = time >= end;
    const pose = mixPoses(poses[i], poses[next], share), y = height - 14, status = isOver ? data.ended : "";
    const beams = angles.map((angle, k) => polar(mix(data.ranges[i][k], data.ranges[next][k], share) / 100, angle));
    [canvas.width, canvas.height] = [width * devicePixelRatio, height * devicePixelRatio]; // clears it, too
    context.scale(devicePixelRatio, devicePixelRatio);
    [scene, colours] = [look(pose, width, height), {}]; // dark mode changes the colours
    drawFloor(pose, poses.slice(0, i + 1), placed(beams, pose));
    const moving = shapes.map(([a, b], k) => {
      const at = mixPoses(obstacles[i][k], obstacles[next][k], share);
      const outline = b ? placed(rectangle([-a, -b, a, b]), at) : circle(at, a);
      return { at, draw: () => prism(outline, 0, OBSTACLE_TOP, "moving") };
    });
    drawStanding([...moving, { at: pose, draw: () => drawRobot(pose) }]);
    context.globalAlpha = 0.3; // the robot shines through walls
    drawRobot(pose);
    context.globalAlpha = 1;
    const ending = [status, pose, data.failed ? "failed" : "ink"];
    for (const [text, at, name] of [["start", poses[0], "start"], ["goal", goal, "goal"], ending])
      if (at) scene.pixels(raised([at], LABEL_HEIGHT), false).forEach((pixel) => write(text, pixel, name));
    stroke([[14, y - 5], [14, y], [14 + scene.scale, y], [14 + scene.scale, y - 5]], "ink", 2);
    write("1 m", [Math.max(14 + scene.scale / 2, 26), y], "ink");
    const [v, w, reward, total, action, reason] = data.rows[Math.max(times[i] < time - 1e-6 ? i : i - 1, 0)];
    const [velocity, turnRate] = [v, w].map((speed) => (Math.round(100 * speed) / 100 + 0).toFixed(2)); // 0, not -0
    const rounded = [reward, total].map((sum) => (Math.abs(sum) < 100 ? +sum.toPrecision(3) : Math.round(sum)));
    const doing = status || texts[reason] || "driving";
    const values = [time.toFixed(1), texts[action], velocity, turnRate, ...rounded, doing];
    figure.querySelectorAll("dd").forEach((cell, k) => (cell.textContent = values[k]));
    figure.querySelector("dl").classList.toggle("failed", isOver && data.failed);
    Object.assign(slider, { value: time, ariaValueText: `${time.toFixed(1)} s of ${end.toFixed(1)} s` });
    button.textContent = isPlaying ? "Pause" : "Play";
  }

  const redraw = (change) => (event) => (change(event), draw());
  const seek = redraw((to) => (time = clamp(to, 0, end)));
  const zoom = redraw((factor) => (camera.zoom = clamp(camera.zoom * factor, 0.15, 2.5)));
  const turn = redraw(([right, down]) => {
    camera.azimuth += 0.008 * right;
    camera.elevation = clamp(camera.elevation + 0.006 * down, 0.1, STEEPEST);
  });
  const play = redraw(() => {
    let last = performance.now();
    isPlaying = !isPlaying;
    if (isPlaying && time >= end) time = 0;
    requestAnimationFrame(function tick(now) {
      if (!isPlaying) return;
      isPlaying = time < end;
      seek(time + (Math.max(now - last, 0) / 1000) * speed.value);
      last = now;
      requestAnimationFrame(tick);
    });
  });
  button.onclick = play;
  slider.oninput = () => seek(+slider.value);
  view.onchange = redraw(() => (camera = { ...VIEWS[view.value] }));
  canvas.onpointerdown = (event) => (canvas.setPointerCapture(event.pointerId), pointers.set(event.pointerId, event));
  canvas.onpointerup = canvas.onpointercancel = (event) => pointers.delete(event.pointerId);
  canvas.onpointermove = (event) => { // one pointer turns the world, a second one zooms
    const before = pointers.get(event.pointerId), other = [...pointers.values()].find((each) => each !== before);
    const gap = (one) => Math.max(Math.hypot(one.clientX - other.clientX, one.clientY - other.clientY), 1);
    if (!before) return;
    if (other) zoom(gap(before) / gap(event));
    turn([other ? 0 : before.clientX - event.clientX, event.clientY - before.clientY]);
    pointers.set(event.pointerId, event);
  };
  canvas.addEventListener("wheel", (event) => {
    if (performance.now() - lastScroll < 250) return; // the page scrolls, and goes on
    event.preventDefault();
    zoom(Math.exp(clamp(event.deltaY, -100, 100) / 400));
  }, { passive: false });
  canvas.onkeydown = slider.onkeydown = (event) => {
    const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key], factor = { "+": 0.8, "-": 1.25 }[event.key];
    if (event.key === " ") play();
    else if (side && event.shiftKey) turn([20 * side, 0]);
    else if (side) seek(times[clamp(state() + side, 0, times.length - 1)]);
    else if (factor) zoom(factor);
    else return;
    event.preventDefault();
  };
  new ResizeObserver(draw).observe(canvas);
  matchMedia("(prefers-color-scheme: dark)").onchange = draw;
}

let lastScroll = -1000; // [ms]
addEventListener("scroll", () => (lastScroll = performance.now()), { passive: true });
document.querySelectorAll(".replay").forEach(show);
