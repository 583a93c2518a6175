// `npm run generate`, a part of `npm run types`: writes the types of what the server takes and
// gives, from interface.json, which a test of the server holds to what it serves.

import { mkdir, readFile, writeFile } from 'node:fs/promises'
import openapi, { astToString } from 'openapi-typescript'

const from = new URL('../interface.json', import.meta.url)
const to = new URL('../src/.generated/interface.d.ts', import.meta.url)

const { openapi: document, messages } = JSON.parse(await readFile(from, 'utf8'))

/** `command-request` to `CommandRequestMessage`: apart from the API's own names. */
function typeName(message) {
  const words = message.split('-').map((word) => word[0].toUpperCase() + word.slice(1))
  return `${words.join('')}Message`
}

/** Definitions inside a message's schema become schemas of the document, by names of their own. */
function inDocument(value, prefix) {
  if (Array.isArray(value)) return value.map((item) => inDocument(item, prefix))
  if (typeof value !== 'object' || value === null) return value
  return Object.fromEntries(
    Object.entries(value)
      .filter(([key]) => key !== '$defs' && key !== '$schema')
      .map(([key, inside]) => {
        if (key !== '$ref') return [key, inDocument(inside, prefix)]
        if (inside === '#') return [key, `#/components/schemas/${prefix}`]
        return [key, inside.replace('#/$defs/', `#/components/schemas/${prefix}.`)]
      }),
  )
}

for (const [message, schema] of Object.entries(messages)) {
  const name = typeName(message)
  document.components.schemas[name] = inDocument(schema, name)
  for (const [inner, definition] of Object.entries(schema.$defs ?? {})) {
    document.components.schemas[`${name}.${inner}`] = inDocument(definition, name)
  }
}
// The same program under another number serves the same.
document.info.version = ''

const types = astToString(await openapi(document, { alphabetize: true }))
await mkdir(new URL('.', to), { recursive: true })
await writeFile(to, `// Made by scripts/generate.mjs.\n\n${types}`)
