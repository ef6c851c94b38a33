// What `three.js` is served with (vendor/README.md), for the type checker only.

export {
  AmbientLight, BoxGeometry, BufferAttribute, BufferGeometry, Color, DirectionalLight, EdgesGeometry, Fog, GridHelper,
  HemisphereLight, LineBasicMaterial, LineSegments, Mesh, MeshBasicMaterial, MeshLambertMaterial, PCFShadowMap,
  PerspectiveCamera, PlaneGeometry, Scene, ShadowMaterial, Vector3, WebGLRenderer,
} from "three";
export type { Material, Object3D } from "three";
export { OrbitControls } from "three/examples/jsm/controls/OrbitControls.js";
