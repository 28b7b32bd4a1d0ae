// Client of a localization service. It sends sealed queries only; a retry sends the same bytes (rule L7).

import { VeilocError } from "./core.js";

const QUERY = "application/x-protobuf";
/** Statuses after which the same bytes may be sent again. */
const RETRYABLE = new Set([408, 429, 503, 504]);

/** Text from the service, made safe to display. */
const printable = (text) =>
  // Removes control characters and marks that change the direction of text.
  String(text ?? "").replace(/[\u0000-\u001f\u007f-\u009f\u061c\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff]/g, "").slice(0, 500);

/** Names of maps and anchors. */
const isName = (name) => /^[A-Za-z0-9_.-]{1,64}$/.test(name) && name !== "." && name !== "..";

const isLoopback = (host) => host === "localhost" || host === "[::1]" || /^127(\.\d+){3}$/.test(host);

const pause = (milliseconds, signal) =>
  new Promise((done, fail) => {
    const timer = setTimeout(done, milliseconds);
    signal?.addEventListener("abort", () => {
      clearTimeout(timer);
      fail(signal.reason);
    }, { once: true });
  });

export class Client {
  #base;
  #options;

  constructor(server, options = {}) {
    const url = new URL(server, globalThis.location?.href);
    const plain = url.protocol === "http:" && !isLoopback(url.hostname) && !options.insecureHttp;
    if (plain || !/^https?:$/.test(url.protocol)) {
      throw new VeilocError("address", `${url.origin}: plain HTTP would send token and query unencrypted; use https`);
    }
    if (url.username || url.password || url.search || url.hash) {
      throw new VeilocError("address", `${url.origin}: the address may have scheme, host, port and path only; use a token to authenticate`);
    }
    const token = options.token?.trim();
    if (token && !/^[\x21-\x7e]+$/.test(token)) throw new VeilocError("token", "a token has no spaces and only ASCII characters");
    this.#base = url.href.replace(/\/+$/, "");
    this.#options = { retries: 4, maxRetryDelay: 20_000, timeout: 60_000, ...options, token };
  }

  /** The maps that the token gives access to. */
  async maps() {
    const reply = await this.#fetch(`${this.#base}/v1/maps`, {});
    return (await json(reply)).maps.map((map) => ({ ...map, name: printable(map.name) }));
  }

  /** The current profile of a map, for `load`. */
  async profile(map) {
    const reply = await this.#fetch(this.#resource(map, "profile"), {});
    check(reply, QUERY);
    return new Uint8Array(await reply.arrayBuffer());
  }

  /** The current pack of a map, for `device.sealer`. */
  async pack(map) {
    const reply = await this.#fetch(this.#resource(map, "pack"), {});
    check(reply, QUERY);
    return new Uint8Array(await reply.arrayBuffer());
  }

  /**
   * All content anchors of a map. With `near`, a place in the map, the nearest comes first and each has its `distance`; the service
   * does not learn the place.
   */
  async anchors(map, { near } = {}) {
    const { anchors } = await json(await this.#fetch(this.#resource(map, "anchors"), {}));
    const isPose = ({ q, t } = {}) => q?.length === 4 && t?.length === 3 && [...q, ...t].every(Number.isFinite);
    if (!Array.isArray(anchors) || !anchors.every((anchor) => isName(anchor?.name) && isPose(anchor.map_from_anchor))) {
      throw new VeilocError("bad-answer", "the answer is no list of anchors");
    }
    if (!near) return anchors;
    const distance = ({ map_from_anchor: { t } }) => Math.hypot(...t.map((c, k) => c - near[k]));
    return anchors.map((anchor) => ({ ...anchor, distance: distance(anchor) })).sort((a, b) => a.distance - b.distance);
  }

  /** Writes a content anchor: a new one, or one that the token owns. The last writer wins. */
  async putAnchor(map, name, { map_from_anchor, content = null }) {
    const body = JSON.stringify({ map_from_anchor, content });
    const headers = { "content-type": "application/json" };
    await this.#fetch(this.#anchor(map, name), { method: "PUT", headers, body });
  }

  /** Deletes a content anchor that the token owns. */
  async deleteAnchor(map, name) {
    await this.#fetch(this.#anchor(map, name), { method: "DELETE" });
  }

  /** Localizes a sealed query, given as its bytes or as the result of `sealer.seal`. */
  async localize(map, query, options = {}) {
    if (query.unbalanced) throw new VeilocError("unbalanced", query.unbalanced);
    const bytes = query instanceof Uint8Array ? query : query.bytes;
    return this.#localize(map, bytes, options);
  }

  /** Localizes in steps, and stops at the first trusted pose (decision 0020). */
  async localizeProgressive(map, sealed, options = {}) {
    if (sealed.unbalanced) throw new VeilocError("unbalanced", sealed.unbalanced);
    const steps = [];
    let last;
    for (const rows of sealed.steps) {
      const bytes = await sealed.step(rows);
      try {
        const answer = await this.#localize(map, bytes, options);
        last = { answer };
      } catch (error) {
        if (error.kind !== "not-localized") throw error;
        last = { error };
      }
      const outcome = last.error ? "not-found" : last.answer.state;
      steps.push({ rows, bytes: bytes.byteLength, outcome });
      const close = !options.accurateTo || (last.answer?.position_sd ?? Infinity) <= options.accurateTo;
      if (last.answer?.state === "trusted" && close) break;
    }
    if (last?.error) throw Object.assign(last.error, { steps });
    return { answer: last.answer, steps };
  }

  async #localize(map, bytes, { trustedOnly, near, signal }) {
    const headers = { "content-type": QUERY, accept: "application/json" };
    if (trustedOnly) headers["veiloc-trusted-only"] = "true";
    if (near) headers["veiloc-near"] = near.join(",");
    const reply = await this.#fetch(this.#resource(map, "localize"), { method: "POST", headers, body: bytes }, signal);
    const answer = await json(reply);
    const isTrusted = answer.state === "trusted";
    if (!(isTrusted || answer.state === "doubtful") || !Array.isArray(answer.doubts) || isTrusted !== (answer.doubts.length === 0)) {
      throw new VeilocError("bad-answer", "the answer does not come from a localization service");
    }
    for (const doubt of answer.doubts) doubt.text = printable(doubt.text);
    if (trustedOnly && !isTrusted) {
      // A service that ignores the header sends the doubtful pose all the same.
      for (const field of ["cam_from_world", "center", "covariance", "center_covariance", "position_sd", "rotation_sd_deg"]) delete answer[field];
    }
    return answer;
  }

  #anchor(map, name) {
    if (!isName(name)) throw new VeilocError("anchor", `${printable(name)} is not a valid name of an anchor`);
    return this.#resource(map, `anchors/${name}`);
  }

  #resource(map, resource) {
    if (!isName(map)) throw new VeilocError("map-name", `${printable(map)} is not a valid map name`);
    return `${this.#base}/v1/maps/${map}/${resource}`;
  }

  async #fetch(url, request, signal) {
    const { token, retries, maxRetryDelay, timeout } = this.#options;
    const headers = { ...request.headers, ...(token && { authorization: `Bearer ${token}` }) };
    for (let tries = 0; ; tries += 1) {
      const limit = AbortSignal.timeout(timeout);
      let reply;
      let failure;
      try {
        reply = await fetch(url, {
          ...request,
          headers,
          // Sends no cookies and no referrer, and follows no redirect to another server.
          credentials: "omit",
          referrerPolicy: "no-referrer",
          redirect: "error",
          signal: signal ? AbortSignal.any([signal, limit]) : limit,
        });
        if (reply.ok) return reply;
        failure = await refusal(reply);
      } catch (error) {
        if (signal?.aborted) throw signal.reason;
        failure = new VeilocError("network", `the service cannot be reached: ${error.message}`, { retryable: true });
      }
      const wait = failure.retryAfter !== undefined ? failure.retryAfter * 1000 : 500 * 2 ** tries;
      if (!failure.retryable || tries >= retries || wait > maxRetryDelay) throw failure;
      await pause(wait, signal);
    }
  }
}

async function refusal(reply) {
  const document = await reply.json().catch(() => ({}));
  const problem = printable(document?.type).replace(/^urn:veiloc:problem:/, "");
  const { status } = reply;
  const message = document?.detail ? `${printable(document.title)}: ${printable(document.detail)}` : `the service answered with status ${status}`;
  let kind = "refused";
  if (status === 422) kind = "not-localized";
  else if (status === 401) kind = "token";
  else if (problem === "wrong-profile") kind = "wrong-profile";
  else if (RETRYABLE.has(status)) kind = "busy";
  const seconds = Number.parseFloat(reply.headers.get("retry-after"));
  return new VeilocError(kind, message, {
    status,
    problem,
    retryable: RETRYABLE.has(status),
    ...(Number.isFinite(seconds) && { retryAfter: seconds }),
  });
}

function check(reply, type) {
  const actual = (reply.headers.get("content-type") ?? "").split(";")[0].trim().toLowerCase();
  if (actual !== type) throw new VeilocError("bad-answer", `the answer has type ${printable(actual)}, not ${type}; is this the address of a veiloc service?`);
}

async function json(reply) {
  check(reply, "application/json");
  return reply.json().catch(() => {
    throw new VeilocError("bad-answer", "the answer is not valid JSON");
  });
}
