// The scene in the page's address:
// ?robot=go2&bundle=…&ground=gap&fault=gaussian&severity=5&left=switch&right=memory&unseen=stop

/** What an address calls a bundle's robot, "Unitree Go2": go2. */
const nickname = ({ robot }) => robot.split(" ").at(-1).toLowerCase();

/**
 * The scene that an address asks for.
 * @param {string} search of the address.
 * @param {object} contract shared with the runtime.
 * @returns {object} bundle, ground, fault (null: none), severity, modes (of the left and of the
 *   right robot), conduct at the end of the ground seen, and `unknown`, what makes no sense.
 */
export function readScene(search, { bundles, faults, faults: [{ levels }], modes, reach }) {
  const asks = new URLSearchParams(search);
  const unknown = [];
  const choose = (key, choices, fallback) => {
    const name = asks.get(key);
    const choice = choices.find((one) => String(one.name) === name);
    if (name !== null && !choice) unknown.push(`${key} "${name.slice(0, 30)}"`);
    return choice ?? choices.find((one) => one.name === fallback) ?? choices[0];
  };
  const robot = asks.has("robot") && choose("robot", bundles.map((one) => ({ name: nickname(one) })), null).name;
  const bundle = choose("bundle", bundles.filter((one) => !robot || nickname(one) === robot), null);
  const ground = choose("ground", bundle.grounds, bundle.opening.ground);
  const none = { name: "none", none: true };
  const fault = choose("fault", [...faults, none], bundle.opening.fault);
  const severity = choose("severity", levels.map((_, i) => ({ name: i + 1 })), levels.length).name;
  const named = modes.map((name) => ({ name }));
  const left = choose("left", named, bundle.opening.left).name;
  const right = choose("right", named, bundle.opening.right).name;
  const conducts = Object.keys(reach.speeds).map((name) => ({ name }));
  const conduct = choose("unseen", conducts, conducts[0].name).name;
  const chosen = { bundle, ground, fault: fault.none ? null : fault, severity, modes: [left, right], conduct };
  return { ...chosen, unknown };
}

/** What leads to one of several bundles: the robot where there are others, the name among its own. */
export function bundleLink(bundle, bundles) {
  const asks = new URLSearchParams();
  const alike = bundles.filter((one) => nickname(one) === nickname(bundle));
  if (alike.length < bundles.length) asks.set("robot", nickname(bundle));
  if (alike.length > 1) asks.set("bundle", bundle.name);
  return asks;
}

/** The address that leads to a scene. */
export function sceneLink({ bundle, ground, fault, severity, modes, conduct }, { bundles, reach }) {
  const asks = bundleLink(bundle, bundles);
  asks.set("ground", ground.name);
  asks.set("fault", fault?.name ?? "none");
  if (fault) asks.set("severity", severity);
  const [left, right] = modes;
  asks.set("left", left);
  asks.set("right", right);
  if (conduct !== Object.keys(reach.speeds)[0]) asks.set("unseen", conduct);
  return `?${asks}`;
}
