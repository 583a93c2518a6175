/**
 * Robots chosen to act on together: a set of ids that the list, the table and
 * the lasso in the arena share. The one robot that is looked at and driven is
 * another thing.
 */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'

export class Selection {
  /** Another set after every change, so that watching the reference is enough. */
  readonly ids: ShallowRef<ReadonlySet<string>> = shallowRef(new Set<string>())

  get size(): number {
    return this.ids.value.size
  }

  has(id: string): boolean {
    return this.ids.value.has(id)
  }

  /** Takes one in, or out. */
  toggle(id: string): void {
    const next = new Set(this.ids.value)
    if (!next.delete(id)) next.add(id)
    this.ids.value = next
  }

  /** These and no others. */
  replace(ids: Iterable<string>): void {
    this.ids.value = new Set(ids)
  }

  add(ids: Iterable<string>): void {
    const next = new Set(this.ids.value)
    for (const id of ids) next.add(id)
    if (next.size !== this.ids.value.size) this.ids.value = next
  }

  clear(): void {
    if (this.ids.value.size > 0) this.ids.value = new Set()
  }
}
