import { createApp } from 'vue'
import App from './App.vue'
import { exclusively } from './account/exclusive'
import { Session } from './account/session'
import { SESSION } from './account/use'
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
const session = new Session({
  send: (...args) => fetch(...args),
  exclusive: exclusively('terracrawler.refresh'),
  channel:
    typeof BroadcastChannel === 'undefined' ? null : new BroadcastChannel('terracrawler.session'),
})
const hurry = (): void => {
  if (!document.hidden) session.hurry()
}
window.addEventListener('online', hurry)
document.addEventListener('visibilitychange', hurry)
createApp(App).provide(SESSION, session).mount('#app')
void session.start()
