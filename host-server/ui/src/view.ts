/** Which page is shown; it stands in the address, so that "back" works. */

import type { Ref } from 'vue'
import { ref } from 'vue'
import type { Role } from './account/roles'

export const PAGES = ['account', 'people', 'keys', 'audit'] as const
export type Page = (typeof PAGES)[number]
export type View = 'room' | Page

const ADMIN_PAGES: ReadonlySet<View> = new Set(['people', 'keys', 'audit'])

export function viewOf(hash: string): View {
  return PAGES.find((page) => hash === `#/${page}`) ?? 'room'
}

/** Pages that somebody may see; nobody has an account where there are none. */
export function pagesFor(role: Role): readonly Page[] {
  return PAGES.filter((page) => role === 'admin' || !ADMIN_PAGES.has(page))
}

export interface Address {
  view: Ref<View>
  hash: Ref<string>
  /** Takes what stands behind the `#` away, and out of the history. */
  clear(): void
  close(): void
}

export function useView(): Address {
  const hash = ref(location.hash)
  const view = ref(viewOf(hash.value))
  const follow = (): void => {
    hash.value = location.hash
    view.value = viewOf(hash.value)
  }
  window.addEventListener('hashchange', follow)
  return {
    view,
    hash,
    clear() {
      history.replaceState(null, '', location.pathname)
      follow()
    },
    close: () => window.removeEventListener('hashchange', follow),
  }
}
