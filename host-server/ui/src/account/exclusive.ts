/**
 * One tab at a time. A refresh token works once, and all tabs share it: two that
 * use it together look like a thief, and the server ends the session.
 */

export type Exclusive = <T>(act: () => Promise<T>) => Promise<T>

interface Locks {
  request<T>(name: string, act: () => Promise<T>): Promise<T>
}

export interface Store {
  getItem(key: string): string | null
  setItem(key: string, value: string): void
  removeItem(key: string): void
}

/** A tab that was closed while it held the place keeps it no longer than this. */
const LEASE_MS = 20_000
/** Time for another tab's claim, made at the same moment, to show. */
const SETTLE_MS = 60
const POLL_MS = 80

/** Browsers have locks only on https and localhost; elsewhere a note in storage must do. */
export function exclusively(
  name: string,
  locks: Locks | null = (navigator.locks as Locks | undefined) ?? null,
  store: Store | null = localStore(),
): Exclusive {
  if (locks !== null) return (act) => locks.request(name, act)
  if (store === null) return (act) => act()
  return (act) => leased(name, store, act)
}

async function leased<T>(name: string, store: Store, act: () => Promise<T>): Promise<T> {
  const me = Math.random().toString(36).slice(2)
  const holder = (): string | null => {
    const [who, until] = (store.getItem(name) ?? '').split(' ')
    const left = Number(until) - Date.now()
    // A clock that was set back must not keep everyone out.
    return who !== undefined && who !== '' && left > 0 && left <= LEASE_MS ? who : null
  }
  for (;;) {
    if (holder() === null) {
      store.setItem(name, `${me} ${String(Date.now() + LEASE_MS)}`)
      await pause(SETTLE_MS)
      if (holder() === me) break
    }
    await pause(POLL_MS * (1 + Math.random()))
  }
  try {
    return await act()
  } finally {
    if (holder() === me) store.removeItem(name)
  }
}

function pause(milliseconds: number): Promise<void> {
  return new Promise((resolve) => setTimeout(resolve, milliseconds))
}

function localStore(): Store | null {
  try {
    // Full or switched off shows only when something is written.
    localStorage.setItem('terracrawler.probe', '')
    localStorage.removeItem('terracrawler.probe')
    return localStorage
  } catch {
    return null
  }
}
