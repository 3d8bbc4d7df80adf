// The scene: body, estimate with its two sigma, landmarks, trails. Metres, z up.

import {
  AmbientLight,
  ArrowHelper,
  BufferAttribute,
  BufferGeometry,
  CanvasTexture,
  ConeGeometry,
  DirectionalLight,
  DoubleSide,
  GridHelper,
  Group,
  Line,
  LineBasicMaterial,
  LineSegments,
  Matrix4,
  Mesh,
  MeshBasicMaterial,
  MeshLambertMaterial,
  OctahedronGeometry,
  PerspectiveCamera,
  Scene,
  SphereGeometry,
  Sprite,
  SpriteMaterial,
  Vector3,
  WebGLRenderer,
} from "three";
import { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
import { rotated } from "./flight.js";

const UP = new Vector3(0, 0, 1);
const ROWS = 700; // of a trail, at most

/** A glider whose nose is along x and whose fin is up. */
function glider(material) {
  const group = new Group();
  const nose = new Mesh(new ConeGeometry(0.13, 1.1, 20), material);
  nose.rotation.z = -Math.PI / 2;
  const flat = (corners) => {
    const geometry = new BufferGeometry();
    geometry.setAttribute("position", new BufferAttribute(new Float32Array(corners.flat()), 3));
    geometry.computeVertexNormals();
    return new Mesh(geometry, material);
  };
  const wing = (side) => flat([[0.25, 0, 0], [-0.3, side * 0.8, 0.06], [-0.45, 0, 0]]);
  group.add(nose, wing(1), wing(-1), flat([[-0.2, 0, 0.05], [-0.55, 0, 0.42], [-0.55, 0, 0.05]]));
  return group;
}

function trail(material) {
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(3 * ROWS), 3));
  const line = new Line(geometry, material);
  line.frustumCulled = false;
  return line;
}

function setTrail(line, points) {
  const { position } = line.geometry.attributes;
  const shown = points.slice(-ROWS);
  shown.forEach((point, i) => position.setXYZ(i, ...point));
  position.needsUpdate = true;
  line.geometry.setDrawRange(0, shown.length);
}

function label(text) {
  const canvas = document.createElement("canvas");
  [canvas.width, canvas.height] = [64, 64];
  const sprite = new Sprite(new SpriteMaterial({ map: new CanvasTexture(canvas), depthTest: false }));
  sprite.scale.set(0.45, 0.45, 1);
  sprite.write = (colour) => {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, 64, 64);
    pen.font = "bold 46px system-ui, sans-serif";
    [pen.textAlign, pen.textBaseline, pen.fillStyle] = ["center", "middle", colour];
    pen.fillText(text, 32, 34);
    sprite.material.map.needsUpdate = true;
  };
  return sprite;
}

/** L with L L^T = a: it takes the unit sphere to the ellipsoid of one standard deviation. */
function cholesky(a) {
  const l = [[0, 0, 0], [0, 0, 0], [0, 0, 0]];
  for (let i = 0; i < 3; ++i) {
    for (let k = 0; k <= i; ++k) {
      let sum = a(i, k);
      for (let m = 0; m < k; ++m) sum -= l[i][m] * l[k][m];
      l[i][k] = i === k ? Math.sqrt(Math.max(sum, 1e-12)) : sum / l[k][k];
    }
  }
  return l;
}

export class View {
  /** Throws if there is no WebGL. */
  constructor(canvas, landmarks) {
    this.canvas = canvas;
    this.renderer = new WebGLRenderer({ canvas, antialias: true, alpha: true });
    this.scene = new Scene();
    this.camera = new PerspectiveCamera(36, 1, 0.1, 200);
    this.camera.up.copy(UP);
    this.camera.position.set(-4, -10, 6.6);
    this.controls = new OrbitControls(this.camera, canvas);
    this.controls.target.set(0, 0, 1.3);
    this.controls.enablePan = false;
    this.controls.minDistance = 2;
    this.controls.maxDistance = 40;
    this.controls.maxPolarAngle = 0.55 * Math.PI;
    canvas.addEventListener("keydown", (event) => this.key(event));

    const light = new DirectionalLight(0xffffff, 2);
    light.position.set(-3, -5, 9);
    this.scene.add(light, new AmbientLight(0xffffff, 1.4));
    this.solid = new MeshLambertMaterial({ side: DoubleSide });
    this.ghost = new MeshLambertMaterial({ side: DoubleSide, transparent: true, opacity: 0.75 });
    this.body = glider(this.solid);
    this.estimate = glider(this.ghost);
    this.cloud = new MeshBasicMaterial({ transparent: true, opacity: 0.25, depthWrite: false });
    this.mesh = new LineBasicMaterial({ transparent: true, opacity: 0.5, depthTest: false });
    const sphere = new SphereGeometry(1, 24, 16);
    this.ellipsoid = new Group();
    this.ellipsoid.add(new Mesh(sphere, this.cloud), new LineSegments(circles(), this.mesh));
    this.ellipsoid.matrixAutoUpdate = false;
    this.trueTrail = trail(new LineBasicMaterial());
    this.trail = trail(new LineBasicMaterial({ transparent: true, opacity: 0.8 }));
    this.scene.add(this.body, this.estimate, this.ellipsoid, this.trueTrail, this.trail);

    this.mark = new MeshLambertMaterial();
    this.marks = landmarks.map((at, i) => {
      const mark = new Mesh(new OctahedronGeometry(0.14), this.mark);
      mark.position.set(...at);
      mark.label = label(`${i + 1}`);
      mark.label.position.set(at[0], at[1], at[2] + 0.38);
      const geometry = new BufferGeometry();
      geometry.setAttribute("position", new BufferAttribute(new Float32Array(6), 3));
      mark.sight = new Line(geometry, new LineBasicMaterial({ transparent: true, opacity: 0.45 }));
      mark.sight.frustumCulled = false;
      this.scene.add(mark, mark.label, mark.sight);
      return mark;
    });
    this.arrows = [0, 1].map(() => {
      const arrow = new ArrowHelper(UP, new Vector3(), 1, 0, 0.22, 0.12);
      this.scene.add(arrow);
      return arrow;
    });
  }

  key(event) {
    const { position } = this.camera;
    const { target } = this.controls;
    const offset = position.clone().sub(target);
    const side = new Vector3().crossVectors(offset, UP).normalize();
    const moves = {
      ArrowLeft: () => offset.applyAxisAngle(UP, -0.1),
      ArrowRight: () => offset.applyAxisAngle(UP, 0.1),
      ArrowUp: () => offset.applyAxisAngle(side, 0.1),
      ArrowDown: () => offset.applyAxisAngle(side, -0.1),
      "+": () => offset.multiplyScalar(0.9),
      "-": () => offset.multiplyScalar(1 / 0.9),
    };
    if (!moves[event.key]) return;
    event.preventDefault();
    moves[event.key]();
    position.copy(target).add(offset); // the controls keep it within their limits
  }

  /** Colours of the page: of the body, the lines, the landmarks, the vectors. */
  colour({ text, line, body, vectors, mark: gold }) {
    this.solid.color.set(body);
    this.trueTrail.material.color.set(body);
    this.mark.color.set(gold);
    for (const mark of this.marks) {
      mark.label.write(text);
      mark.sight.material.color.set(gold);
    }
    this.arrows.forEach((arrow, i) => arrow.setColor(vectors[i]));
    this.grid?.removeFromParent();
    this.grid = new GridHelper(16, 16, line, line);
    this.grid.rotation.x = Math.PI / 2;
    this.scene.add(this.grid);
  }

  draw(run, selected, colour) {
    const { truth, sensors } = run.flight;
    const place = (object, { attitude: [w, x, y, z], position }) => {
      object.position.set(...position);
      object.quaternion.set(x, y, z, w);
    };
    const filter = run.filters[selected];
    const { attitude, position } = filter;
    place(this.body, truth);
    place(this.estimate, { attitude, position });
    for (const each of [this.ghost, this.cloud, this.mesh, this.trail.material]) each.color.set(colour);
    setTrail(this.trueTrail, run.history.map((row) => row.position));
    const own = run.history.filter((row) => row.started === run.started); // a start is a jump
    setTrail(this.trail, own.map((row) => row.filters[selected].position));

    const { covariance } = filter;
    this.ellipsoid.visible = Number.isFinite(covariance[0]);
    if (this.ellipsoid.visible) {
      const l = cholesky((i, k) => covariance[6 * (3 + i) + 3 + k]);
      const axes = [0, 1, 2].map((k) => rotated(attitude, l.map((row) => 2 * row[k])));
      const [a, b, c] = axes.map((axis) => new Vector3(...axis));
      this.ellipsoid.matrix = new Matrix4().makeBasis(a, b, c).setPosition(...position);
      this.ellipsoid.matrixWorldNeedsUpdate = true;
    }

    this.marks.forEach((mark, i) => {
      mark.sight.visible = i < filter.settings.landmarks.length && sensors.landmarks !== "cut";
      const ends = mark.sight.geometry.attributes.position;
      ends.setXYZ(0, ...truth.position);
      ends.setXYZ(1, ...mark.position);
      ends.needsUpdate = true;
    });
    this.arrows.forEach((arrow, i) => {
      arrow.visible = Boolean(run.sample) && sensors[`vector${i + 1}`] !== "cut";
      if (!arrow.visible) return;
      const v = new Vector3(...rotated(truth.attitude, run.sample.vectors[i]));
      arrow.position.set(...truth.position);
      arrow.setLength(1.2 * v.length(), 0.22, 0.12);
      arrow.setDirection(v.normalize());
    });

    const { clientWidth, clientHeight } = this.canvas;
    const ratio = Math.min(devicePixelRatio, 2);
    if (this.size !== `${clientWidth} ${clientHeight} ${ratio}`) {
      this.size = `${clientWidth} ${clientHeight} ${ratio}`;
      this.renderer.setPixelRatio(ratio);
      this.renderer.setSize(clientWidth, clientHeight, false);
      this.camera.aspect = clientWidth / clientHeight;
      const wide = Math.atan(0.5 / this.camera.aspect); // the figure fits into a narrow view too
      this.camera.fov = Math.max(36, (360 / Math.PI) * wide);
      this.camera.updateProjectionMatrix();
    }
    this.controls.update();
    this.renderer.render(this.scene, this.camera);
  }
}

/** Three great circles of the unit sphere, as separate lines. */
function circles() {
  const points = [];
  const n = 48;
  for (let axis = 0; axis < 3; ++axis) {
    for (let i = 0; i < n; ++i) {
      for (const angle of [(2 * Math.PI * i) / n, (2 * Math.PI * (i + 1)) / n]) {
        const point = [Math.cos(angle), Math.sin(angle)];
        point.splice(axis, 0, 0);
        points.push(...point);
      }
    }
  }
  const geometry = new BufferGeometry();
  geometry.setAttribute("position", new BufferAttribute(new Float32Array(points), 3));
  return geometry;
}
