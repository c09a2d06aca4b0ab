import loadMujoco from "@mujoco/mujoco";
import * as ort from "onnxruntime-web";
import {readFileSync} from "node:fs";
import {Simulation} from "/work/wt/page/src/renet/page/web/simulation.js";
ort.env.wasm.numThreads=1;
const contract=JSON.parse(readFileSync("/tmp/contract.json"));
const B="/work/wt/page/src/renet/pretrained/go1-parkour/";
const manifest=JSON.parse(readFileSync(B+"manifest.json"));
const sessions={};
for (const n of ["actor","estimator","vision"]) sessions[n]=await ort.InferenceSession.create(new Uint8Array(readFileSync(B+n+".onnx")),{executionProviders:["wasm"]});
const mujoco=await loadMujoco();
const [,, sceneName="flat", fault="blackout", sev="5", speed="0.6", onset="5", T="16", seeds="2"]=process.argv;
const scene=contract.scenes.find(s=>s.name===sceneName);
for (let seed=1; seed<=+seeds; seed++) for (const est of ["vp","renet","op"]) {
  const sim=new Simulation({mujoco,sessions,manifest,contract},scene,seed); sim.controller.estimator=est;
  const t0=performance.now(); let out="";
  for (let k=0;k<50*T;k++){
    if (k===Math.round(50*onset) && fault!=="none") sim.camera.break(contract.faults.find(f=>f.name===fault),+sev,sim.now);
    await sim.step({speed:+speed,turn:0});
    if (k%50===49){ const p=sim.world.pose().position; out+=` ${p[0].toFixed(1)},${p[1].toFixed(1)},${p[2].toFixed(2)}${sim.walking?sim.controller.driving:"-"}`;}
  }
  console.log(sceneName,fault,sev,"seed",seed,est,sim.upright?"up":"DOWN",sim.speed.toFixed(2),"cpu/s",((performance.now()-t0)/1000/T).toFixed(3),sim.controller.reason,sim.controller.selector.reason,sim.controller.policy.anomalyScore.toExponential(2),"\n  ",out);
  sim.delete();
}
