defmodule MavRouter.Link.Core.Reception do
  @moduledoc "What a link that is up hears: frames, bytes without frames, or nothing. Pure, of an `MavRouter.Link.Core`."

  alias MavRouter.Link.Core

  @sniff_every_ms 10_000

  @doc "Whether the silence is long enough to connect or search again, and no vehicle is reached by the link."
  @spec silent?(Core.t(), mono :: integer) :: boolean
  def silent?(%{spec: %{announced: true}} = core, mono), do: unneeded?(core, mono - heard_at(core))

  # A port with a configured rate stays open: a radio may be out of range, and may still hear us.
  def silent?(%{spec: %{detect: detect}} = core, mono) when detect != nil,
    do: unneeded?(core, mono - max(heard_at(core), bytes_at(core)))

  def silent?(_core, _mono), do: false

  # A vehicle that is silent for minutes answers to where it heard us last.
  defp unneeded?(core, silent_ms), do: silent_ms >= core.silent_ms and not core.needed?.(:remote)

  @doc "Whether bytes come, but no frame was among them for a while (`:garbled_ms`)."
  @spec garbled?(Core.t(), mono :: integer) :: boolean
  def garbled?(core, mono) do
    bytes_at(core) - heard_at(core) >= core.garbled_ms and mono - bytes_at(core) < core.garbled_ms
  end

  @doc "Has it found out what the bytes are, every #{div(@sniff_every_ms, 1000)} s while no frame is among them."
  @spec sniff(Core.t(), mono :: integer) :: {Core.t(), [:sniff]}
  def sniff(%{spec: %{sniffed: true}} = core, mono) do
    cond do
      not garbled?(core, mono) -> {%{core | diagnosis: [], sniff_at: nil}, []}
      core.sniff_at == nil or mono >= core.sniff_at -> {sniffed(core, mono), [:sniff]}
      true -> {core, []}
    end
  end

  def sniff(core, _mono), do: {core, []}

  @doc "That was done, or begins, now."
  @spec sniffed(Core.t(), mono :: integer) :: Core.t()
  def sniffed(core, mono), do: %{core | sniff_at: mono + @sniff_every_ms}

  @doc "A link that is open has nothing to complain of; its next search begins with what was found."
  @spec found(Core.t(), info :: map) :: Core.t()
  def found(core, %{finding: finding}) when finding != nil,
    do: %{core | found: %{path: finding.path, baud: finding.baud}, diagnosis: []}

  def found(core, _info), do: %{core | diagnosis: []}

  defp heard_at(core), do: core.heard || core.opened

  defp bytes_at(%{peers: %{map: %{remote: peer}}}), do: peer.heard
  defp bytes_at(core), do: core.opened
end
