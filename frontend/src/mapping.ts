// Between the page's pixels and the camera's. Pure: no DOM.
//
// The pane shows the camera's picture scaled by `scale` CSS pixels a camera pixel, its top left corner at (left, top) of
// the pane. Camera pixel (0, 0) is the centre of the top left pixel, so that the picture reaches from -0.5 to width - 0.5.
// Neither the device's pixel ratio nor the size of the image file takes part: an image of another size than the camera's
// is shown over the same rectangle.

export interface Point { readonly x: number; readonly y: number }
export interface Pixel { readonly u: number; readonly v: number }
export interface Size { readonly width: number; readonly height: number }
export interface View { readonly scale: number; readonly left: number; readonly top: number }

export const MAX_ZOOM = 16;

/** The largest size of a picture's shape that fits into a space. */
export function fitted(picture: Size, space: Size): Size {
  const scale = Math.min(space.width / picture.width, space.height / picture.height);
  return { width: Math.max(picture.width * scale, 1), height: Math.max(picture.height * scale, 1) };
}

/** The whole picture in a pane, centred. */
export function wholeView(picture: Size, pane: Size): View {
  const scale = Math.min(pane.width / picture.width, pane.height / picture.height);
  return {
    scale,
    left: (pane.width - picture.width * scale) / 2,
    top: (pane.height - picture.height * scale) / 2,
  };
}

export function toPixel(view: View, at: Point): Pixel {
  return { u: (at.x - view.left) / view.scale - 0.5, v: (at.y - view.top) / view.scale - 0.5 };
}

export function toPane(view: View, at: Pixel): Point {
  return { x: (at.u + 0.5) * view.scale + view.left, y: (at.v + 0.5) * view.scale + view.top };
}

export function contains(picture: Size, at: Pixel): boolean {
  return at.u >= -0.5 && at.v >= -0.5 && at.u <= picture.width - 0.5 && at.v <= picture.height - 0.5;
}

/** Zoomed by a factor; what was seen at `from` is then seen at `to`, as far as the bounds allow. */
export function zoomed(view: View, factor: number, from: Point, picture: Size, pane: Size, to: Point = from): View {
  const whole = wholeView(picture, pane).scale;
  const scale = Math.min(Math.max(view.scale * factor, whole), whole * MAX_ZOOM);
  const ratio = scale / view.scale;
  return held(
    { scale, left: to.x - (from.x - view.left) * ratio, top: to.y - (from.y - view.top) * ratio },
    picture,
    pane,
  );
}

export function panned(view: View, dx: number, dy: number, picture: Size, pane: Size): View {
  return held({ scale: view.scale, left: view.left + dx, top: view.top + dy }, picture, pane);
}

/** The same part of the picture in a pane of another size: the centre stays, and the zoom against the whole picture. */
export function resized(view: View, picture: Size, before: Size, after: Size): View {
  const zoom = view.scale / wholeView(picture, before).scale;
  const centre = toPixel(view, { x: before.width / 2, y: before.height / 2 });
  const scale = wholeView(picture, after).scale * zoom;
  return held(
    {
      scale,
      left: after.width / 2 - (centre.u + 0.5) * scale,
      top: after.height / 2 - (centre.v + 0.5) * scale,
    },
    picture,
    after,
  );
}

/** No empty border where there is picture to show instead. */
function held(view: View, picture: Size, pane: Size): View {
  return {
    scale: view.scale,
    left: heldAlong(view.left, picture.width * view.scale, pane.width),
    top: heldAlong(view.top, picture.height * view.scale, pane.height),
  };
}

function heldAlong(start: number, length: number, space: number): number {
  return length <= space ? (space - length) / 2 : Math.min(Math.max(start, space - length), 0);
}
