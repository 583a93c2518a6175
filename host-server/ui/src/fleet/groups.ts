/**
 * Groups of robots under a name, kept on this machine for whoever is logged in:
 * the server has no place for them.
 */

import type { ShallowRef } from 'vue'
import { shallowRef } from 'vue'

export interface Group {
  name: string
  robots: readonly string[]
}

const MOST_GROUPS = 100
export const LONGEST_NAME = 40

export class Groups {
  readonly all: ShallowRef<readonly Group[]>
  private readonly key: string

  constructor(
    user: string | null,
    private readonly storage: Pick<Storage, 'getItem' | 'setItem'> | null,
  ) {
    this.key = `terracrawler.groups.${user ?? ''}`
    this.all = shallowRef(this.read())
  }

  get(name: string): Group | undefined {
    return this.all.value.find((group) => group.name === name)
  }

  /** Keeps a group, in the place of one of the same name. False when there is no room or no name. */
  save(name: string, robots: Iterable<string>): boolean {
    const called = name.trim().slice(0, LONGEST_NAME)
    const others = this.all.value.filter((group) => group.name !== called)
    if (called === '' || others.length >= MOST_GROUPS) return false
    const group = { name: called, robots: [...new Set(robots)].sort() }
    if (group.robots.length === 0) return false
    return this.write([...others, group].sort((a, b) => a.name.localeCompare(b.name)))
  }

  remove(name: string): void {
    this.write(this.all.value.filter((group) => group.name !== name))
  }

  private write(groups: readonly Group[]): boolean {
    this.all.value = groups
    try {
      this.storage?.setItem(this.key, JSON.stringify(groups))
    } catch {
      // Storage may be full or off; the groups then last as long as the page.
    }
    return true
  }

  /** Anything may stand in storage. */
  private read(): readonly Group[] {
    try {
      const kept: unknown = JSON.parse(this.storage?.getItem(this.key) ?? '[]')
      if (!Array.isArray(kept)) return []
      return kept.slice(0, MOST_GROUPS).flatMap((value: unknown) => {
        const { name, robots } = (value ?? {}) as Record<string, unknown>
        if (typeof name !== 'string' || name === '' || !Array.isArray(robots)) return []
        const ids = robots.filter((id): id is string => typeof id === 'string')
        return ids.length === 0 ? [] : [{ name: name.slice(0, LONGEST_NAME), robots: ids }]
      })
    } catch {
      return []
    }
  }
}
