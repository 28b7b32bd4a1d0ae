// Localizes the frames of a camera: seals them in one session, and sends each to a service.
//
//     npx tsc --noEmit --strict --skipLibCheck false --module nodenext --target es2022 --lib es2022,dom examples/web/locate.ts

import { type Answer, Client, type Sealed, VeilocError, load, watchOrientation } from "veiloc";

export interface Position {
  center: [number, number, number];
  /** Standard deviation, map units. */
  sd: number;
}

/** Positions of the frames of a video, until the signal aborts. */
export async function* locate(video: HTMLVideoElement, camera: string | null, server: string, map: string, token: string, signal: AbortSignal): AsyncGenerator<Position> {
  const client = new Client(server, { token });
  const device = await load(await client.profile(map));
  const sensors = await watchOrientation();
  try {
    // Frames of one scene share a session; otherwise their lines intersect at the keypoints.
    const sealer = (await device.sealer({ maxKeypoints: 1024 })).inSession(await device.session());
    while (!signal.aborted) {
      const seal = async () => sealer.seal(await sealer.extract(video, camera, { attitude: sensors.now() }));
      const answer = await localize(client, map, seal, signal);
      if (answer?.state === "trusted" && answer.center && answer.position_sd != null) {
        yield { center: answer.center, sd: answer.position_sd };
      }
    }
  } finally {
    sensors.stop();
    device.close();
  }
}

/** The answer; null after an error that a later frame may not have. */
async function localize(client: Client, map: string, seal: () => Promise<Sealed>, signal: AbortSignal): Promise<Answer | null> {
  try {
    const sealed = await seal();
    const { answer, steps } = await client.localizeProgressive(map, sealed, { trustedOnly: true, signal });
    await sealed.free();
    console.log(`${steps.reduce((sum, step) => sum + step.bytes, 0)} bytes sent`);
    return answer;
  } catch (error) {
    // Without motion sensors a walk is refused (`too-many-starts`) until the camera is back, or in another part of the scene.
    const temporary = ["not-localized", "texture", "unbalanced", "busy", "too-many-starts", "turned-away"];
    if (error instanceof VeilocError && temporary.includes(error.kind)) return null;
    throw error;
  }
}
