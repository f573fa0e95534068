// The skin and the touched objects in 3D: x along the image's columns, y along its rows, z towards the tip.

import * as THREE from "three";
import { OrbitControls } from "./vendor/OrbitControls.js";
import { VIRIDIS, objectColour, stepOf } from "./colours.js";
import { heightAt, rimOf, skinPoint } from "./geometry.js";

// The surface: rings around the centre of the disc, so that its edge is the skin's and its cost does not depend on the map.
const RINGS = 64, SPOKES = 144, VERTICES = 1 + RINGS * SPOKES;
const UNIT = new Float32Array(2 * VERTICES); // row and column of each vertex from the disc's centre, in radii of the disc
const TRIANGLES = [];
for (let ring = 1; ring <= RINGS; ring++) {
  for (let spoke = 0; spoke < SPOKES; spoke++) {
    const n = 1 + (ring - 1) * SPOKES + spoke, next = 1 + (ring - 1) * SPOKES + ((spoke + 1) % SPOKES);
    UNIT[2 * n] = (ring / RINGS) * Math.sin((2 * Math.PI * spoke) / SPOKES);
    UNIT[2 * n + 1] = (ring / RINGS) * Math.cos((2 * Math.PI * spoke) / SPOKES);
    if (ring === 1) TRIANGLES.push(0, n, next);
    else TRIANGLES.push(n - SPOKES, n, next, n - SPOKES, next, next - SPOKES);
  }
}
// Linear light of the screen values 0 to 255: the lamp's light is multiplied by linear values.
const LINEAR = Float32Array.from({ length: 256 }, (_, v) => (v <= 10 ? v / 255 / 12.92 : ((v / 255 + 0.055) / 1.055) ** 2.4));
const SLOW_MS = 40; // after a picture that takes longer, all pictures have fewer pixels
const COARSEST = 0.5; // of the screen's pixels per side
const REST = 1; // pause after a picture, relative to its drawing time: without a graphics card, drawing uses all cores and the page falls behind
const POINTS_MAX = 20000;

export class SkinView {
  /** free(): called when the current picture is done. */
  constructor(free) {
    this.free = free;
    this.seq = null; // sequence number of the map in the picture
    this.host = document.getElementById("view");
    this.available = document.createElement("canvas").getContext("webgl2") !== null;
    if (!this.available) {
      document.getElementById("no-webgl").hidden = false;
      return;
    }
    this.renderer = new THREE.WebGLRenderer({ alpha: true, antialias: true });
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.host.append(this.renderer.domElement);
    this.scene = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(35, 1, 1, 1000);
    this.camera.up.set(0, 0, 1);
    this.scene.add(new THREE.AmbientLight(0xffffff, 1.3), this.camera);
    const lamp = new THREE.DirectionalLight(0xffffff, 3);
    lamp.position.set(-1, 0.7, 0.15); // to one side of the eye: a dent has a shaded side
    this.camera.add(lamp);
    this.controls = new OrbitControls(this.camera, this.renderer.domElement);
    this.controls.addEventListener("change", () => this.render());
    this.controls.addEventListener("start", () => { this.untouched = false; });
    this.skin = new THREE.Mesh(
      new THREE.BufferGeometry(),
      // Shallow skin is nearly black: without a sheen, its form would not show.
      new THREE.MeshPhongMaterial({ specular: 0x202020, shininess: 10, vertexColors: true, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: 2, polygonOffsetUnits: 2 }),
    );
    this.cloud = new THREE.Points(new THREE.BufferGeometry(), new THREE.PointsMaterial({ size: 2.5, sizeAttenuation: false, vertexColors: true }));
    for (const [shape, count] of [[this.skin.geometry, VERTICES], [this.cloud.geometry, POINTS_MAX]]) {
      for (const name of ["position", "color"]) shape.setAttribute(name, new THREE.BufferAttribute(new Float32Array(3 * count), 3));
    }
    this.skin.geometry.setIndex(TRIANGLES);
    this.rim = new THREE.LineLoop(new THREE.BufferGeometry(), new THREE.LineBasicMaterial({ color: 0x888888 }));
    this.skin.frustumCulled = this.cloud.frustumCulled = this.rim.frustumCulled = false;
    this.axes = new THREE.AxesHelper(1);
    this.scene.add(this.skin, this.cloud, this.rim, this.axes);
    for (const [id, object] of [["show-skin", this.skin], ["show-cloud", this.cloud]]) {
      document.getElementById(id).addEventListener("change", (event) => {
        object.visible = event.target.checked;
        this.render();
      });
    }
    document.getElementById("home").addEventListener("click", () => this.look());
    new ResizeObserver(() => this.resize()).observe(this.host);
    this.clear();
  }

  /** Forget another sensor's shape. */
  clear() {
    if (!this.available) return;
    this.geometry = null;
    this.skin.geometry.setDrawRange(0, 0);
    this.cloud.geometry.setDrawRange(0, 0);
    this.rim.visible = this.axes.visible = false;
    this.map = null;
    this.render();
  }

  setSkin(map, geometry, scale_mm) {
    if (!this.available || !geometry) return;
    if (geometry !== this.geometry) this.place(geometry);
    this.map = map;
    const { position, color } = this.skin.geometry.attributes;
    for (let n = 0, at = 0; n < VERTICES; n++, at += 3) {
      const row = geometry.row_c + UNIT[2 * n] * geometry.radius_px, col = geometry.col_c + UNIT[2 * n + 1] * geometry.radius_px;
      const h = heightAt(map, row, col);
      skinPoint(geometry, row, col, h, position.array, at);
      const step = 3 * stepOf(h, scale_mm);
      for (let k = 0; k < 3; k++) color.array[at + k] = LINEAR[VIRIDIS[step + k]];
    }
    position.needsUpdate = color.needsUpdate = true;
    this.skin.geometry.setDrawRange(0, Infinity);
    this.skin.geometry.computeVertexNormals();
  }

  setCloud(cloud) {
    if (!this.available) return;
    const count = cloud ? cloud.labels.length : 0, every = Math.max(1, Math.ceil(count / POINTS_MAX));
    const { position, color } = this.cloud.geometry.attributes, colour = new THREE.Color();
    let label = -1, shown = 0;
    for (let n = 0; n < count; n += every, shown++) {
      if (cloud.labels[n] !== label) {
        label = cloud.labels[n];
        colour.set(objectColour(label));
      }
      for (let k = 0; k < 3; k++) position.array[3 * shown + k] = cloud.points_mm[3 * n + k];
      colour.toArray(color.array, 3 * shown);
    }
    position.needsUpdate = color.needsUpdate = true;
    this.cloud.geometry.setDrawRange(0, shown);
  }

  /** Set the rim, the axes and the eye for a sensor. */
  place(geometry) {
    this.geometry = geometry;
    const { rim, foot } = rimOf(geometry);
    const ring = Array.from({ length: 96 }, (_, k) => (2 * Math.PI * k) / 96);
    this.rim.geometry.setFromPoints(ring.map((a) => new THREE.Vector3(rim * Math.cos(a), rim * Math.sin(a), foot)));
    this.axes.scale.setScalar(0.3 * rim);
    this.axes.position.set(-0.85 * rim, -0.85 * rim, foot);
    this.rim.visible = this.axes.visible = true;
    this.look();
  }

  look() {
    if (!this.geometry) return;
    this.untouched = true;
    // A picture narrower than 1.3 times its height would cut off the axes at the left.
    const { rim, foot } = rimOf(this.geometry), far = (3.1 * rim) / Math.min(1, this.camera.aspect / 1.3);
    this.controls.target.set(0, -0.12 * rim, foot);
    this.camera.position.set(0.2 * far, -0.7 * far, foot + 0.68 * far);
    this.controls.update();
    this.render();
  }

  resize() {
    const { clientWidth, clientHeight } = this.host;
    if (!clientWidth || !clientHeight) return;
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
    this.renderer.setSize(clientWidth, clientHeight);
    if (this.untouched) this.look();
    this.render();
  }

  /** Whether a picture is being drawn, or the pause after it lasts: a new map waits, here and in the 2D view. */
  get busy() {
    return Boolean(this.fence);
  }

  render() {
    if (!this.available) return;
    this.renderer.render(this.scene, this.camera);
    this.seq = this.map?.seq ?? null;
    if (this.fence) return;
    // Commands return at once and run elsewhere: only a fence reports when a picture is finished. Without a graphics
    // card a picture takes a hundred times longer, and a page that does not wait makes its browser fall behind.
    const gl = this.renderer.getContext(), began_ms = performance.now();
    this.fence = gl.fenceSync(gl.SYNC_GPU_COMMANDS_COMPLETE, 0);
    gl.flush();
    const done = () => {
      if (this.fence && !gl.isContextLost() && gl.getSyncParameter(this.fence, gl.SYNC_STATUS) !== gl.SIGNALED) {
        setTimeout(done, 5);
        return;
      }
      gl.deleteSync(this.fence);
      const took_ms = performance.now() - began_ms, slow = took_ms > SLOW_MS && this.renderer.getPixelRatio() > COARSEST;
      setTimeout(() => {
        this.fence = null;
        if (slow) {
          this.renderer.setPixelRatio(COARSEST);
          this.render();
        }
        this.free();
      }, REST * took_ms);
    };
    setTimeout(done, 5);
  }
}
