defmodule Aerie.Link.Hearing do
  @moduledoc "What a link that is up hears: frames, bytes without frames, or nothing. Pure, of an `Aerie.Link.Core`."

  alias Aerie.Link.Core

  @doc "Whether the silence is long enough to connect or search again."
  @spec silent?(Core.t(), mono :: integer) :: boolean
  def silent?(%{spec: %{announced: true}} = core, mono), do: mono - heard_at(core) >= core.silent_ms

  # A port with a configured rate stays open: a radio may be out of range, and may still hear us.
  def silent?(%{spec: %{detect: detect}} = core, mono) when detect != nil,
    do: mono - max(heard_at(core), bytes_at(core)) >= core.silent_ms

  def silent?(_core, _mono), do: false

  @doc "Whether bytes come, but no frame was among them for a while (`:garbled_ms`)."
  @spec garbled?(Core.t(), mono :: integer) :: boolean
  def garbled?(core, mono) do
    bytes_at(core) - heard_at(core) >= core.garbled_ms and mono - bytes_at(core) < core.garbled_ms
  end

  defp heard_at(core), do: core.heard || core.opened

  defp bytes_at(%{peers: %{map: %{remote: peer}}}), do: peer.heard
  defp bytes_at(core), do: core.opened
end
