// Seals frames of one place in a session, and asks a service where each was taken: what an app with a camera does.
//
//     npx tsc --noEmit --strict --skipLibCheck false --module nodenext --target es2022 --lib es2022,dom examples/web/locate.ts

import { type Answer, Client, type Sealed, VeilocError, load, watchOrientation } from "veiloc";

export interface Place {
  center: [number, number, number];
  /** Standard deviation, map units. */
  sd: number;
}

/** Where the frames of a video were taken, one after the other; ends when the signal does. */
export async function* locate(video: HTMLVideoElement, camera: string | null, server: string, map: string, token: string, signal: AbortSignal): AsyncGenerator<Place> {
  const client = new Client(server, { token });
  const device = await load(await client.profile(map));
  const sensors = await watchOrientation();
  try {
    // Frames of one place share a session: their lines do not cross in what they show.
    const session = await device.session();
    while (!signal.aborted) {
      const seal = () => device.sealed(video, camera, { session, held: sensors.now(), maxKeypoints: 1024 });
      const answer = await ask(client, map, seal, signal);
      if (answer?.trusted && answer.center && answer.position_sd != null) {
        yield { center: answer.center, sd: answer.position_sd };
      }
    }
  } finally {
    sensors.stop();
    device.close();
  }
}

/** The answer, or none where a later frame may fare better. */
async function ask(client: Client, map: string, seal: () => Promise<Sealed>, signal: AbortSignal): Promise<Answer | null> {
  try {
    const sealed = await seal();
    const { answer, steps } = await client.localizeProgressive(map, sealed, { trustedOnly: true, signal });
    await sealed.free();
    console.log(`${steps.reduce((sum, step) => sum + step.bytes, 0)} bytes sent`);
    return answer;
  } catch (error) {
    // Where no sensor says how the camera is held, a walk is refused (`too-many-starts`) until it is back, or somewhere else.
    const passing = ["not-localized", "lopsided", "busy", "too-many-starts", "turned-away"];
    if (error instanceof VeilocError && passing.includes(error.kind)) return null;
    throw error;
  }
}
