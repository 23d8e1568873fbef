import { readFileSync } from 'node:fs';
import { defineConfig } from 'vite';
import { viteSingleFile } from 'vite-plugin-singlefile';

/** The notice that three's licence asks for, in the one file that is shipped. */
const notice = {
  name: 'notice',
  transformIndexHtml: {
    order: 'post',
    handler: (html) => {
      const text = readFileSync('node_modules/three/LICENSE', 'utf8').trim();
      return html.replace('</html>', `</html>\n<!--\n${text}\n-->`);
    },
  },
};

export default defineConfig({
  plugins: [viteSingleFile(), notice],
  server: { fs: { allow: ['..'] } },
  build: { target: 'es2022', outDir: 'dist', emptyOutDir: true },
});
