// A GIF that loops forever, for browsers that encode no video: one palette for all pictures, LZW.

const LEVELS = [6, 7, 6]; // of red, green, blue: 252 colours

// Pictures are canvases of one side; each is held for so many seconds.
function gif(pictures, side) {
  const out = [], word = (value) => out.push(value & 255, value >> 8);
  out.push(...new TextEncoder().encode("GIF89a"));
  word(side);
  word(side);
  out.push(0xf7, 0, 0, ...palette(), 0x21, 0xff, 11, ...new TextEncoder().encode("NETSCAPE2.0"), 3, 1, 0, 0, 0);
  for (const { picture, hold } of pictures) {
    out.push(0x21, 0xf9, 4, 0);
    word(Math.round(100 * hold));
    out.push(0, 0, 0x2c, 0, 0, 0, 0);
    word(side);
    word(side);
    out.push(0, 8);
    const packed = lzw(indices(picture.getContext("2d").getImageData(0, 0, side, side).data));
    for (let at = 0; at < packed.length; at += 255) {
      const block = packed.slice(at, at + 255);
      out.push(block.length, ...block);
    }
    out.push(0);
  }
  out.push(0x3b);
  return new Blob([new Uint8Array(out)], { type: "image/gif" });
}

function palette() {
  const [reds, greens, blues] = LEVELS, found = [];
  for (let k = 0; k < 256; k++) {
    const rgb = [Math.floor(k / (greens * blues)) / (reds - 1), (Math.floor(k / blues) % greens) / (greens - 1), (k % blues) / (blues - 1)];
    found.push(...rgb.map((value) => Math.min(Math.round(255 * value), 255)));
  }
  return found;
}

// The palette's number of each pixel.
function indices(rgba) {
  const [reds, greens, blues] = LEVELS, nearest = (value, levels) => Math.round((value * (levels - 1)) / 255);
  return Uint8Array.from({ length: rgba.length / 4 }, (_, k) => (nearest(rgba[4 * k], reds) * greens + nearest(rgba[4 * k + 1], greens)) * blues + nearest(rgba[4 * k + 2], blues));
}

// LZW as GIF has it, for numbers of 8 bits: codes of 9 to 12 bits, lowest bit first.
function lzw(values) {
  const clear = 256, end = 257, packed = [];
  let codes = new Map(), bits = 9, held = 0, many = 0, next = 258, now = values[0];
  const write = (code) => {
    held |= code << many;
    many += bits;
    for (; many >= 8; many -= 8, held >>>= 8) packed.push(held & 255);
  };
  write(clear);
  for (let k = 1; k < values.length; k++) {
    const pair = (now << 8) | values[k], known = codes.get(pair);
    if (known !== undefined) {
      now = known;
      continue;
    }
    write(now);
    if (next < 4096) {
      if (next === 1 << bits) bits++;
      codes.set(pair, next++);
    } else {
      write(clear);
      [codes, bits, next] = [new Map(), 9, 258];
    }
    now = values[k];
  }
  write(now);
  if (next === 1 << bits && bits < 12) bits++;
  write(end);
  if (many) packed.push(held & 255);
  return packed;
}
