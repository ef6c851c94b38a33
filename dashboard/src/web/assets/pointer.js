// The pointer over a drawing: it places, selects and drags blocks.

/** @import { Editor } from "./editor.js" */
/** @import { Block, Vector } from "./types" */

export class Pointer {
  /**
   * Where the pointer went down, pixels.
   * @type {[number, number] | null}
   */
  pressed = null;
  /**
   * The block that the pointer drags, where it was, and the cell at the height of its bottom that was taken hold of.
   * @type {{ block: Block, at: Vector, cell: Vector } | null}
   */
  dragged = null;

  /** @param {Editor} editor */
  constructor(editor) {
    this.editor = editor;
    const { canvas } = editor.parts;
    // A second finger or another button moves the view.
    canvas.addEventListener("pointerdown", (event) => this.press(event));
    canvas.addEventListener("pointercancel", () => this.drop());
    canvas.addEventListener("pointerup", (event) => this.release(event));
    canvas.addEventListener("pointermove", (event) => this.hover(event));
    canvas.addEventListener("pointerleave", () => editor.desk && editor.desk.hint(null));
  }

  /**
   * Returns the block or cell under the pointer.
   * @param {PointerEvent} event
   */
  under(event) {
    return this.editor.desk.pick(...this.pixel(event));
  }

  /**
   * Returns where the pointer is on the canvas, pixels.
   * @param {PointerEvent} event
   * @returns {[number, number]}
   */
  pixel(event) {
    const box = this.editor.parts.canvas.getBoundingClientRect();
    return [event.clientX - box.left, event.clientY - box.top];
  }

  /** @param {PointerEvent} event */
  press(event) {
    this.pressed = event.isPrimary && event.button === 0 ? [event.clientX, event.clientY] : null;
    if (!this.editor.desk || !this.pressed || this.editor.tool) return;
    const hit = this.under(event);
    if (!hit || hit.block === null) return;
    const block = this.editor.blocks[hit.block];
    const held = this.editor.desk.cellAt(...this.pixel(event), block.at[2]);
    if (!held) return;
    this.dragged = { block, at: block.at, cell: held.cell };
    this.editor.parts.canvas.setPointerCapture(event.pointerId);
    // The view stays as it is meanwhile.
    this.editor.desk.controls.enabled = false;
  }

  /**
   * Moves the dragged block along the floor.
   * @param {PointerEvent} event
   */
  drag(event) {
    const { block, at, cell } = this.dragged;
    const over = this.editor.desk.cellAt(...this.pixel(event), at[2]);
    if (!over) return;
    block.at = at.map((v, k) => v + over.cell[k] - cell[k]);
    this.editor.draw();
  }

  /** Leaves the dragged block where it is. */
  drop() {
    if (!this.dragged) return;
    const { block, at } = this.dragged;
    const to = block.at;
    this.dragged = null;
    this.editor.desk.controls.enabled = true;
    if (to.join() === at.join()) return;
    block.at = at;
    this.editor.change(() => { block.at = to; });
  }

  /** @param {PointerEvent} event */
  release(event) {
    this.drop();
    // A drag moved a block or the view instead.
    if (!this.editor.desk || !event.isPrimary || !this.pressed || Math.hypot(event.clientX - this.pressed[0], event.clientY - this.pressed[1]) > 5) return;
    const hit = this.under(event);
    this.editor.desk.hint(null);
    if (this.editor.tool) {
      if (hit) this.editor.place(this.editor.fitting(hit.cell, hit.normal));
    } else {
      this.editor.selected = hit ? hit.block : null;
      this.editor.draw();
    }
  }

  /** @param {PointerEvent} event */
  hover(event) {
    if (this.dragged) this.drag(event);
    if (!this.editor.desk || !this.editor.tool || event.pointerType !== "mouse" || event.buttons !== 0) return;
    const hit = this.under(event);
    this.editor.desk.hint(hit && this.editor.fitting(hit.cell, hit.normal));
  }
}
