// Loads what a simulation needs: MuJoCo, the bundle's manifest, the contract, then the models.

import loadMujoco from "@mujoco/mujoco";
import * as ort from "onnxruntime-web";

const MODELS = ["actor", "estimator", "vision"];
const PHYSICS = "vendor/@mujoco/mujoco/mujoco.wasm";
const INFERENCE = "vendor/onnxruntime-web/dist/ort-wasm-simd-threaded.wasm";

/** A reader of a bundle's and the page's large files that tells how much has come, from 0 to 1. */
export function countingReader(sizes, { folder, look }, show) {
  const models = MODELS.map((name) => `${folder}/${name}.onnx`);
  const files = [PHYSICS, INFERENCE, look, `${folder}/manifest.json`, ...models];
  const total = files.reduce((sum, path) => sum + (sizes[path] ?? 0), 0);
  let loaded = 0;
  return async (path) => {
    const bytes = new Uint8Array(sizes[path]);
    const reader = (await request(path)).body.getReader();
    const next = () => naming(path, reader.read());
    let at = 0;
    for (let part = await next(); !part.done; part = await next()) {
      bytes.set(part.value, at);
      at += part.value.length;
      loaded += part.value.length;
      show(loaded / total);
    }
    return bytes;
  };
}

/** The contract: what Python knows and the page needs. */
export const loadContract = async () => (await request("renet-page.json")).json();

async function request(path) {
  const answer = await naming(path, fetch(path));
  if (!answer.ok) throw new Error(`${path}: ${answer.status} ${answer.statusText}`);
  return answer;
}

/** Name a file in the error of a connection that fails, which names none. */
async function naming(path, step) {
  try {
    return await step;
  } catch (error) {
    throw new Error(`${path}: ${error.message}`);
  }
}

/**
 * What a picture of the start needs; the models, without which nothing walks, come afterwards.
 * @param {(path: string) => Promise<Uint8Array>} read a file of the page.
 * @param {object} contract of `loadContract`.
 * @param {object} bundle one of the contract's.
 * @returns {Promise<object>} mujoco, manifest, contract, bundle; sessions, empty until `loadModels`.
 */
export async function loadRuntime(read, contract, bundle) {
  const manifest = JSON.parse(new TextDecoder().decode(await read(`${bundle.folder}/manifest.json`)));
  const mujoco = await loadMujoco({ wasmBinary: await read(PHYSICS) });
  return { mujoco, manifest, contract, bundle, sessions: {} };
}

/** Fill a runtime's sessions, one after the other: they share one WebAssembly instance. */
export async function loadModels({ sessions, bundle }, read) {
  ort.env.wasm.numThreads = 1;
  ort.env.wasm.wasmBinary ??= await read(INFERENCE);
  for (const name of MODELS) {
    const model = await read(`${bundle.folder}/${name}.onnx`);
    sessions[name] = await ort.InferenceSession.create(model, { executionProviders: ["wasm"] });
  }
}
