// main.js
import { Client, load } from "veiloc";

const client = new Client(location.origin);
const [{ name }] = await client.maps();
const device = await load(await client.profile(name));
const sealer = await device.sealer();
const image = document.getElementById("image");
image.disabled = false;
image.addEventListener("change", async ({ target }) => {
  const answer = document.getElementById("answer");
  try {
    const query = await sealer.seal(await sealer.extract(target.files[0]));
    const { state, center } = await client.localize(name, query);
    answer.value = `${state === "trusted" ? "At" : "Perhaps at"} ${center}`;
  } catch (error) {
    answer.value = error.message;
  }
});
