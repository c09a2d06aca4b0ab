// Loads what a simulation needs: MuJoCo, the bundle's models, its manifest and the contract.

import loadMujoco from "@mujoco/mujoco";
import * as ort from "onnxruntime-web";

const MODELS = ["actor", "estimator", "vision"];

/**
 * @param {(path: string) => Promise<Uint8Array>} read a file of the page.
 * @param {object} mujocoOptions of the WebAssembly module, such as `wasmBinary`.
 * @returns {Promise<object>} mujoco, sessions, manifest and contract, as `Simulation` takes them.
 */
export async function loadRuntime(read, mujocoOptions = {}) {
  ort.env.wasm.numThreads = 1;
  const json = async (path) => JSON.parse(new TextDecoder().decode(await read(path)));
  const session = async (name) =>
    ort.InferenceSession.create(await read(`bundle/${name}.onnx`), { executionProviders: ["wasm"] });
  // One after the other: the sessions share one WebAssembly instance, which starts with the first.
  const open = async () => {
    const sessions = {};
    for (const name of MODELS) sessions[name] = await session(name);
    return sessions;
  };
  const [mujoco, sessions, manifest, contract] = await Promise.all([
    loadMujoco(mujocoOptions),
    open(),
    json("bundle/manifest.json"),
    json("contract.json"),
  ]);
  return { mujoco, sessions, manifest, contract };
}
