// Numbers as an engineer writes them: as many digits as the error allows.

const MINUS = "\u2212";
const DIGITS_OF_ERROR = 2;
const DIGITS_ALONE = 5;

const signed = (text) => text.replace(/-/g, MINUS);
const isNumber = (value) => typeof value === "number" && Number.isFinite(value);

/** `value` with `digits` figures, in powers of ten where it is very small or large. */
export function plain(value, digits = DIGITS_ALONE) {
  if (!isNumber(value)) return "\u2013";
  const size = Math.abs(value);
  if (size && (size < 1e-4 || size >= 1e6)) return signed(value.toExponential(digits - 1));
  return signed(String(Number(value.toPrecision(digits))));
}

/** Value and error on one scale: `[value, error]` as text, two digits of the error. */
export function withError(value, std) {
  if (!isNumber(std) || std <= 0) return [plain(value), ""];
  const power = Math.floor(Math.log10(std)) - DIGITS_OF_ERROR + 1;
  const decimals = Math.max(0, -power);
  const scale = Math.max(Math.abs(value), std);
  if (scale < 1e-3 || scale >= 1e7) {
    const tens = Math.floor(Math.log10(scale));
    const digits = Math.min(12, Math.max(0, tens - power));
    const by = 10 ** tens;
    const text = (number) => `${signed((number / by).toFixed(digits))}e${signed(String(tens))}`;
    return [text(value), text(std)];
  }
  const unit = 10 ** Math.max(0, power);
  const text = (number) =>
    signed((Math.round(number / unit) * unit).toFixed(0));
  if (unit > 1) return [text(value), text(std)];
  return [signed(value.toFixed(Math.min(decimals, 12))), std.toFixed(Math.min(decimals, 12))];
}

export const percent = (value) => (isNumber(value) ? `${signed(value.toFixed(1))}\u00a0%` : "\u2013");

export const seconds = (value) => `${plain(value, 6)}\u00a0s`;

/** Whether there is a unit to write; a bare number has "-". */
export const hasUnit = (unit) => Boolean(unit) && unit !== "-";

/** A name with its unit, which is not broken over two lines. */
export const withUnit = (name, unit) =>
  (hasUnit(unit) ? `${name} [${unit.replace(/ /g, "\u00a0")}]` : name);

/** The unit of a ratio; none where one of the two is unknown ("-" is known). */
export function perUnit(above, below) {
  if (!above || !below) return "";
  return hasUnit(below) ? `${hasUnit(above) ? above : "1"} per ${below}` : above;
}

/** A name of at most `most` letters, its middle left out where it is longer. */
export function brief(name, most) {
  if (name.length <= most) return name;
  const tail = Math.floor((most - 1) / 2);
  return `${name.slice(0, most - 1 - tail)}\u2026${name.slice(-tail)}`;
}

export const ratioOf = (name, above, below) => withUnit(name, perUnit(above, below));

export function count(number, one, many = `${one}s`) {
  return `${number.toLocaleString("en")} ${number === 1 ? one : many}`;
}
