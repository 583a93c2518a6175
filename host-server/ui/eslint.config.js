import js from '@eslint/js'
import globals from 'globals'
import vue from 'eslint-plugin-vue'
import { defineConfig } from 'eslint/config'
import ts from 'typescript-eslint'

export default defineConfig([
  { ignores: ['dist/', 'src/.generated/'] },
  { linterOptions: { reportUnusedDisableDirectives: 'error' } },
  js.configs.recommended,
  ts.configs.strict,
  vue.configs['flat/recommended'],
  {
    files: ['**/*.vue'],
    languageOptions: { parserOptions: { parser: ts.parser } },
  },
  {
    files: ['src/**', 'tests/unit/**'],
    languageOptions: { globals: globals.browser },
    rules: {
      'no-console': 'error',
      // What the server leaves out is `null` or not there at all.
      eqeqeq: ['error', 'always', { null: 'ignore' }],
      '@typescript-eslint/consistent-type-imports': 'error',
      // Prettier decides how markup is laid out.
      'vue/html-self-closing': 'off',
      'vue/max-attributes-per-line': 'off',
      'vue/singleline-html-element-content-newline': 'off',
      'vue/html-indent': 'off',
      'vue/html-closing-bracket-newline': 'off',
    },
  },
  {
    files: ['tests/mock/**', 'e2e/**', 'bench/**', 'scripts/**', '*.config.*'],
    // Browser names too: functions handed to `page.evaluate` run there.
    languageOptions: { globals: { ...globals.node, ...globals.browser } },
  },
])
