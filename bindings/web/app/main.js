// main.js
import { Client, load } from "veiloc";

const image = document.getElementById("image");
const answer = document.getElementById("answer");
const shown = (work) => work().catch((error) => (answer.value = error.message));

shown(async () => {
  const client = new Client(location.origin);
  const [{ name }] = await client.maps();
  const device = await load(await client.profile(name));
  const sealer = await device.sealer();
  image.disabled = false;
  image.addEventListener("change", ({ target }) =>
    shown(async () => {
      const query = await sealer.seal(await sealer.extract(target.files[0]));
      const { state, center } = await client.localize(name, query);
      answer.value = `${state === "trusted" ? "At" : "Perhaps at"} ${center}`;
    }),
  );
});
