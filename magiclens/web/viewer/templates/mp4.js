// A silent MP4, encoded picture by picture: nothing is played for it, so that a slow machine drops no frame.

const FILM_CODECS = ["avc1.42001f", "vp09.00.21.08"]; // H.264 plays everywhere; some browsers have no encoder for it
const UNITY = [0x10000, 0, 0, 0, 0x10000, 0, 0, 0, 0x40000000];

// Canvases of one side, each shown for so many frames; null where the browser encodes no video.
async function mp4(pictures, side, fps) {
  for (const codec of "VideoEncoder" in window ? FILM_CODECS : []) {
    try {
      return container(await encoded(pictures, { codec, width: side, height: side, framerate: fps, bitrate: 4e6 }), codec, side, fps);
    } catch {
      // a browser that says it can, and cannot
    }
  }
  return null;
}

// What the encoder makes of each frame, and what a player must know of the encoder.
async function encoded(pictures, config) {
  if (!(await VideoEncoder.isConfigSupported(config)).supported) throw new Error("no such encoder");
  const samples = [];
  let trouble = null, about = null;
  const encoder = new VideoEncoder({
    output(chunk, { decoderConfig } = {}) {
      const content = new Uint8Array(chunk.byteLength);
      chunk.copyTo(content);
      samples.push({ content, key: chunk.type === "key" });
      about ??= decoderConfig?.description ?? null;
    },
    error: (error) => (trouble = error),
  });
  encoder.configure(config);
  let at = 0;
  for (const { picture, frames } of pictures) {
    for (let k = 0; k < frames; k++) {
      const frame = new VideoFrame(picture, { timestamp: Math.round((at++ * 1e6) / config.framerate) });
      encoder.encode(frame);
      frame.close();
    }
    await pause();
  }
  await encoder.flush();
  encoder.close();
  if (trouble || samples.length < at) throw trouble ?? new Error("frames are missing");
  return { samples, about: about && new Uint8Array(about.buffer ?? about, about.byteOffset ?? 0, about.byteLength) };
}

const bigEndian = (size) => (...values) => Uint8Array.from(values.flatMap((value) => Array.from({ length: size }, (_, k) => (value / 256 ** (size - 1 - k)) & 255)));
const u8 = bigEndian(1), u16 = bigEndian(2), u32 = bigEndian(4);
const letters = (text) => new TextEncoder().encode(text);

function joined(...parts) {
  const all = new Uint8Array(parts.reduce((sum, part) => sum + part.length, 0));
  let at = 0;
  for (const part of parts) {
    all.set(part, at);
    at += part.length;
  }
  return all;
}

// A box of ISO/IEC 14496-12: its length, its name, its content; ``fullBox`` has a version and flags before that.
const box = (name, ...parts) => ((content) => joined(u32(content.length + 8), letters(name), content))(joined(...parts));
const fullBox = (name, flags, ...parts) => box(name, u32(flags), ...parts);

// One track whose samples lie in one chunk; each takes one tick.
function container({ samples, about }, codec, side, fps) {
  const start = box("ftyp", letters("isom"), u32(512), letters("isomiso2avc1mp41"));
  const head = (offset) => box("moov", fullBox("mvhd", 0, u32(0, 0, fps, samples.length, 0x10000), u16(0x100, 0, 0, 0, 0, 0), u32(...UNITY, 0, 0, 0, 0, 0, 0, 2)), track(samples, sampleEntry(codec, about, side), side, fps, offset));
  const first = start.length + head(0).length + 8;
  return new Blob([start, head(first), box("mdat", ...samples.map((sample) => sample.content))], { type: "video/mp4" });
}

function track(samples, entry, side, fps, offset) {
  const many = samples.length, keys = samples.flatMap((sample, k) => (sample.key ? [k + 1] : []));
  const table = box(
    "stbl", fullBox("stsd", 0, u32(1), entry), fullBox("stts", 0, u32(1, many, 1)), fullBox("stss", 0, u32(keys.length, ...keys)), fullBox("stsc", 0, u32(1, 1, many, 1)),
    fullBox("stsz", 0, u32(0, many, ...samples.map((sample) => sample.content.length))), fullBox("stco", 0, u32(1, offset)),
  );
  const media = box("minf", fullBox("vmhd", 1, u32(0, 0)), box("dinf", fullBox("dref", 0, u32(1), fullBox("url ", 1))), table);
  return box(
    "trak", fullBox("tkhd", 3, u32(0, 0, 1, 0, many, 0, 0, 0, 0, ...UNITY, side * 65536, side * 65536)),
    box("mdia", fullBox("mdhd", 0, u32(0, 0, fps, many), u16(0x55c4, 0)), fullBox("hdlr", 0, u32(0), letters("vide"), u32(0, 0, 0), u8(0)), media),
  );
}

// What kind of samples these are: H.264 as its encoder describes itself, or VP9 of 8 bits.
function sampleEntry(codec, about, side) {
  const kind = about ? box("avcC", about) : fullBox("vpcC", 1 << 24, u8(0, 21, 0x82, 1, 1, 1), u16(0));
  return box(codec.slice(0, 4), u16(0, 0, 0, 1, 0, 0, 0, 0, 0, 0, 0, 0, side, side, 72, 0, 72, 0, 0, 0, 1), new Uint8Array(32), u16(24, 65535), kind);
}
