/**
 * Which page is shown, of which robot, filtered how: all of it stands in the
 * address, so that "back" works and a link shows a colleague the same.
 */

import type { InjectionKey, Ref } from 'vue'
import { inject, ref } from 'vue'
import type { Role } from './account/roles'

/** What an operator goes between all day; the first is the home page. */
export const PLACES = [
  'room',
  'dashboard',
  'robots',
  'command',
  'simulation',
  'history',
  'experiments',
  'updates',
] as const
/** Accounts and administration. */
const PAGES = ['account', 'people', 'keys', 'audit'] as const
export type Place = (typeof PLACES)[number]
export type Page = (typeof PAGES)[number]
/** Pages that a place leads to, and which place. */
const WITHIN = { 'what-if': 'history' } as const satisfies Readonly<Record<string, Place>>
export type Inner = keyof typeof WITHIN
export type View = Place | Page | Inner

const ADMIN_PAGES: ReadonlySet<View> = new Set(['people', 'keys', 'audit'])
const VIEWS: readonly View[] = [...PLACES, ...PAGES, ...(Object.keys(WITHIN) as Inner[])]

export type Query = Readonly<Record<string, string>>

interface Route {
  view: View
  /** The robot whose page it is; only of the view `robots`. */
  robot: string | null
  /** The experiment whose page it is; only of the view `experiments`. */
  experiment: string | null
  /** The release whose page it is; only of the view `updates`. */
  release: string | null
  query: Query
}

/** Never throws: a link may be cut off anywhere. */
export function parseRoute(hash: string): Route {
  const [path = '', search = ''] = hash.replace(/^#\/?/, '').split(/\?(.*)/s)
  const [name = '', id = ''] = path.split('/')
  const view = VIEWS.find((known) => known === name) ?? 'room'
  const of = (wanted: View): string | null => (view === wanted && id !== '' ? decoded(id) : null)
  return {
    view,
    robot: of('robots'),
    experiment: of('experiments'),
    release: of('updates'),
    query: Object.fromEntries(new URLSearchParams(search)),
  }
}

export function formatRoute({ view, robot, experiment, release, query }: Route): string {
  return linkTo(view, query, robot ?? experiment ?? release)
}

/** A link to a page, or to that of one robot, experiment or release. */
export function linkTo(view: View, query: Query = {}, id: string | null = null): string {
  const path = view === 'room' ? '' : view
  const of = id === null ? '' : `/${encodeURIComponent(id)}`
  const set = Object.entries(query).filter(([, value]) => value !== '')
  const search = new URLSearchParams(set).toString()
  return `#/${path}${of}${search === '' ? '' : `?${search}`}`
}

export const robotLink = (id: string, query: Query = {}): string => linkTo('robots', query, id)

/** How much of the time before and after a moment its link shows. */
const BEFORE_MS = 240_000
const AFTER_MS = 60_000

/** A link to how things were at a moment, Unix milliseconds. */
export function momentLink(at: number, robot: string | null = null): string {
  const time = Math.round(at)
  const [from, to] = [time - BEFORE_MS, time + AFTER_MS].map(String) as [string, string]
  return linkTo('history', { from, to, at: String(time), robot: robot ?? '' })
}

export function viewOf(hash: string): View {
  return parseRoute(hash).view
}

export function isPage(view: View): view is Page {
  return (PAGES as readonly View[]).includes(view)
}

/** The place that a page belongs to, in the bar of places. */
export function placeOf(view: View): View {
  return view in WITHIN ? WITHIN[view as Inner] : view
}

/** Pages that somebody may see; nobody has an account where there are none. */
export function pagesFor(role: Role): readonly Page[] {
  return PAGES.filter((page) => role === 'admin' || !ADMIN_PAGES.has(page))
}

export interface Address {
  view: Ref<View>
  hash: Ref<string>
  route: Ref<Route>
  /** Changes what the page is asked for, in place: going back leaves the page. */
  change(query: Query): void
  /** Whether the browser went elsewhere and has not said so yet: its event comes with a delay. */
  leaving(): boolean
  /** Takes what stands behind the `#` away, and out of the history. */
  clear(): void
  close(): void
}

export function useView(): Address {
  const hash = ref(location.hash)
  const route = ref(parseRoute(hash.value))
  const view = ref(route.value.view)
  const follow = (): void => {
    hash.value = location.hash
    route.value = parseRoute(hash.value)
    view.value = route.value.view
  }
  window.addEventListener('hashchange', follow)
  const leaving = (): boolean => location.hash !== hash.value
  return {
    view,
    hash,
    route,
    leaving,
    change(query) {
      // Where somebody just went must not be undone by what was asked for before.
      if (leaving()) follow()
      const next = formatRoute({ ...route.value, query: { ...route.value.query, ...query } })
      if (next === hash.value || (next === '#/' && hash.value === '')) return
      history.replaceState(history.state, '', next)
      follow()
    },
    clear() {
      history.replaceState(null, '', location.pathname)
      follow()
    },
    close: () => window.removeEventListener('hashchange', follow),
  }
}

export const ADDRESS: InjectionKey<Address> = Symbol('address')

export function useAddress(): Address {
  const address = inject(ADDRESS)
  if (address === undefined) throw new Error('no address is provided')
  return address
}

function decoded(text: string): string {
  try {
    return decodeURIComponent(text)
  } catch {
    return text
  }
}
