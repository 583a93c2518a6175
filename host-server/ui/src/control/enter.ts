/** What is behind the login: loaded while it is being found out who is there. */

import type { Session } from '../account/session'
import { createApi } from '../api'
import { feedUrl } from '../feed/connection'
import { Room } from './room'

export { default as ControlRoom } from '../components/ControlRoom.vue'

export function makeRoom(session: Session): Room {
  return new Room({
    api: createApi(session.send),
    role: session.role,
    // Where nobody logs in there is no ticket, and no call to wait for.
    url: () =>
      session.state.value === 'open'
        ? feedUrl(location)
        : session.ticket().then((ticket) => feedUrl(location, ticket)),
  })
}
