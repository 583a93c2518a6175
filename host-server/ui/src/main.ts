import { createApp } from 'vue'
import App from './App.vue'
import { createApi } from './api'
import { ROOM, Room } from './control/room'
import { feedUrl } from './feed/connection'
import './styles/index.css'
import { applyTheme } from './theme'

declare global {
  // For diagnosis and for tests in a browser: a read-only look at the fleet.
  var terracrawler: { robots: () => RobotView[] } | undefined
}

interface RobotView {
  id: string
  state: string
  presence: string
  x: number
  y: number
  heading: number
}

applyTheme()
const room = new Room({ url: feedUrl(location), api: createApi() })
globalThis.terracrawler = Object.freeze({
  robots: () =>
    [...room.fleet.all()]
      .filter((robot) => robot.placed)
      .map(({ id, state, presence, x, y, heading }) => ({ id, state, presence, x, y, heading })),
})
createApp(App).provide(ROOM, room).mount('#app')
room.start()
