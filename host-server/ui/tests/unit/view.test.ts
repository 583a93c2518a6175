// @vitest-environment happy-dom

import { afterEach, describe, expect, it } from 'vitest'
import { formatRoute, linkTo, parseRoute, robotLink, useView } from '../../src/view'

describe('the address', () => {
  afterEach(() => history.replaceState(null, '', location.pathname))

  it('names page, robot and what is asked for', () => {
    expect(parseRoute('#/robots/sim-0001?range=1h&tab=log')).toEqual({
      view: 'robots',
      robot: 'sim-0001',
      experiment: null,
      release: null,
      query: { range: '1h', tab: 'log' },
    })
    expect(parseRoute('#/robots?q=a%26b').query).toEqual({ q: 'a&b' })
    expect(parseRoute('#/dashboard').view).toBe('dashboard')
    expect(parseRoute('#/?robot=rover-1')).toEqual({
      view: 'room',
      robot: null,
      experiment: null,
      release: null,
      query: { robot: 'rover-1' },
    })
    expect(parseRoute('#/experiments/7?curves=success')).toEqual({
      view: 'experiments',
      robot: null,
      experiment: '7',
      release: null,
      query: { curves: 'success' },
    })
  })

  it('names a release', () => {
    expect(parseRoute('#/updates/9f2c1ab034d5e6f7')).toEqual({
      view: 'updates',
      robot: null,
      experiment: null,
      release: '9f2c1ab034d5e6f7',
      query: {},
    })
    expect(parseRoute('#/updates').release).toBeNull()
  })

  it('is the home page whatever else stands there', () => {
    for (const hash of ['', '#', '#/', '#/nonsense', '#invite=abc', '#/%E0%A4%A', '#?x']) {
      expect(parseRoute(hash).view).toBe('room')
    }
    expect(parseRoute('#/robots/%E0%A4%A').robot).toBe('%E0%A4%A')
  })

  it('comes back from what it is written to', () => {
    for (const hash of [
      '#/',
      '#/robots',
      '#/robots/a%20b?range=1h',
      '#/robots?q=a%3Db&show=stale',
      '#/experiments/a%20b?curves=success',
      '#/updates/9f2c1ab034d5e6f7',
    ]) {
      expect(formatRoute(parseRoute(hash))).toBe(hash)
    }
    expect(linkTo('robots', { show: 'stale', q: '' })).toBe('#/robots?show=stale')
    expect(robotLink('sim-0001')).toBe('#/robots/sim-0001')
  })

  it('changes in place', () => {
    const address = useView()
    const steps = history.length
    address.change({ robot: 'rover-1' })
    expect(location.hash).toBe('#/?robot=rover-1')
    expect(address.route.value.query['robot']).toBe('rover-1')
    address.change({ robot: '' })
    expect(location.hash).toBe('#/')
    expect(history.length).toBe(steps)
    address.close()
  })

  it('is changed where somebody just went, though the browser has not said so yet', () => {
    const address = useView()
    history.replaceState(null, '', '#/robots?show=stale')
    expect(address.leaving()).toBe(true)
    address.change({ q: 'rover' })
    expect(location.hash).toBe('#/robots?show=stale&q=rover')
    expect([address.view.value, address.leaving()]).toEqual(['robots', false])
    history.replaceState(null, '', '#/')
    address.close()
  })
})
