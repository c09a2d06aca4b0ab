// Loads what a simulation needs: MuJoCo, the bundle's manifest, the contract, then the models.

import loadMujoco from "@mujoco/mujoco";
import * as ort from "onnxruntime-web";

const MODELS = ["actor", "estimator", "vision"];

/**
 * What a picture of the start needs; the models, without which nothing walks, come afterwards.
 * @param {(path: string) => Promise<Uint8Array>} read a file of the page.
 * @returns {Promise<object>} mujoco, manifest, contract, and sessions, empty until `loadModels`.
 */
export async function loadRuntime(read) {
  const json = async (path) => JSON.parse(new TextDecoder().decode(await read(path)));
  const [mujoco, manifest, contract] = await Promise.all([
    loadMujoco(),
    json("bundle/manifest.json"),
    json("renet-page.json"),
  ]);
  return { mujoco, manifest, contract, sessions: {} };
}

/** Fill a runtime's sessions, one after the other: they share one WebAssembly instance. */
export async function loadModels({ sessions }, read) {
  ort.env.wasm.numThreads = 1;
  for (const name of MODELS) {
    const model = await read(`bundle/${name}.onnx`);
    sessions[name] = await ort.InferenceSession.create(model, { executionProviders: ["wasm"] });
  }
}
