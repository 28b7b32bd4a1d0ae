{{/* Labels of all objects. */}}
{{- define "veiloc.labels" -}}
app.kubernetes.io/name: veiloc
app.kubernetes.io/instance: {{ .Release.Name }}
app.kubernetes.io/version: {{ .Chart.AppVersion | quote }}
app.kubernetes.io/managed-by: {{ .Release.Service }}
{{- end }}

{{/* Labels of the pods of a part; takes a dict of root and part. */}}
{{- define "veiloc.selector" -}}
app.kubernetes.io/name: veiloc
app.kubernetes.io/instance: {{ .root.Release.Name }}
app.kubernetes.io/component: {{ .part }}
{{- end }}

{{/* Settings as TOML: strings, numbers, booleans and lists of them. */}}
{{- define "veiloc.toml" -}}
{{- range $key, $value := . }}
{{ $key }} = {{ $value | toJson }}
{{- end }}
{{- end }}

{{/* The deployments of this release, by name, and which values each has. */}}
{{- define "veiloc.parts" -}}
{{- if .Values.cluster.enabled }}
gateway: service
worker: worker
{{- else }}
service: service
{{- end }}
{{- end }}

{{/* Rights of a container. */}}
{{- define "veiloc.rights" -}}
allowPrivilegeEscalation: false
readOnlyRootFilesystem: true
capabilities: {drop: [ALL]}
{{- end }}
