// vite.config.js
const proxy = { "/v1": { target: process.env.VEILOC || "http://127.0.0.1:8080", changeOrigin: true } };
// Vite must not bundle the package while developing: its worker would not be found.
export default { server: { proxy }, preview: { proxy }, optimizeDeps: { exclude: ["veiloc"] } };
