// An embedding as a picture: its numbers as greys, the least black and the greatest white.

import { h } from "./dom.js";

export function pictureOf({ shape, values, form }) {
  const [rows, columns] = shape.slice(-2);
  const planes = values.length / (rows * columns);
  const canvas = h("canvas", {
    width: columns,
    height: rows,
    role: "img",
    "aria-label": `An embedding of ${rows} by ${columns} numbers, ${form}`,
  });
  // Spread and reduce would be arguments of one call: too many for an embedding of a fine sensor.
  let least = Infinity;
  let most = -Infinity;
  for (const value of values) {
    least = Math.min(least, value);
    most = Math.max(most, value);
  }
  const grey = (value) => (most > least ? (255 * (value - least)) / (most - least) : 128);
  const context = canvas.getContext("2d");
  const image = context.createImageData(columns, rows);
  for (let place = 0; place < rows * columns; place += 1) {
    for (let channel = 0; channel < 3; channel += 1) {
      const plane = planes === 3 ? channel : 0;
      image.data[4 * place + channel] = grey(values[plane * rows * columns + place]);
    }
    image.data[4 * place + 3] = 255;
  }
  context.putImageData(image, 0, 0);
  return canvas;
}
