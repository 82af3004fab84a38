defmodule MavRouter.Link.Core.Snapshot do
  @moduledoc """
  What everybody may know about a link. The link's process publishes it in `Aerie.Base.Store`: `brief/2` as a whole, of `:peers`
  and `:sources` only what changed (`MavRouter.Link.Peers.PublishedPeers`). `Aerie.Base.Store.Links` puts them together.

  | key | value |
  |---|---|
  | `:id`, `:network`, `:kind`, `:url`, `:spec` | as in `MavRouter.Link.Spec` (`:url` is its `text`) |
  | `:status` | `:connecting`, `:up`, `:idle` (up, but no frame for a while), `:down`, `:ended` |
  | `:text` | the status in words: `connection refused by 127.0.0.1:5760, next try in 3.2 s` |
  | `:reason` | the last fault in words, or nil |
  | `:since` | unix microseconds of the last change of phase |
  | `:retry_in_ms` | while down: time to the next attempt, at the time of publishing |
  | `:local`, `:port`, `:peer` | our end, its real port, the other end, as far as known |
  | `:baud` | of an open serial port |
  | `:finding` | how an open serial port was found, if it was searched for (`MavRouter.Link.Serial.Finding`) |
  | `:diagnosis` | why serial ports do not work: findings with evidence and advice, otherwise empty |
  | `:last_heard` | unix microseconds of the arrival of the last good frame |
  | `:counters` | `MavRouter.Link.Core.Counters` |
  | `:rates` | per second: `bytes_in`, `frames_in`, `bytes_out`, `writes_out`, `crc_errors` |
  | `:overload` | `%{since: unix us, datagrams: n}` while datagrams come faster than they are read and for 10 s after, otherwise nil; `datagrams` were dropped |
  | `:behind` | `%{since: unix us, frames: n}` while a session does not keep up with the frames of its vehicle and for 10 s after, otherwise nil; `frames` were dropped |
  | `:peers` | `[%{peer, text, silent_ms, frames_in, bytes_in}]`, at most 1,024 of them |
  | `:sources` | `%{{system, component} => %{received, lost, ratio, …}}`, loss by sequence numbers (R7, R9) |
  | `:signing` | `MavRouter.Signing.link/2`, nil without a key |
  | `:quality` | score, loss, round-trip time and age, and whether it carries its group (`t:MavRouter.Endpoints.Meter.quality/0`), or nil |
  | `:recording` | `t:MavRouter.Recorder.Status.t/0` without its names, nil if it was never recorded |
  | `:restarts` | monotonic ms of the last restarts of the link's process |
  | `:label` | the label of the configuration, or nil |
  | `:high_latency` | whether it is configured as a high-latency link (`MavCodec.Meaning.HighLatency`) |
  """

  alias MavRouter.Link.Core
  alias MavRouter.Link.Peers.Peer
  alias MavRouter.Link.Peers
  alias MavRouter.Link.Core.Rates
  alias MavRouter.Link.Reason
  alias MavRouter.Link.Serial.Finding
  alias MavRouter.Link.Spec
  alias Aerie.Base.Store

  @type status :: :connecting | :up | :idle | :down | :ended

  @doc "The snapshot at a monotonic time in ms."
  @spec of(Core.t(), integer) :: map
  def of(core, mono) do
    core
    |> brief(mono)
    |> Map.merge(%{peers: peers(core.peers, mono), sources: Peers.sources(core.peers)})
  end

  @doc "The snapshot without peers and sources: its size does not depend on how many there are."
  @spec brief(Core.t(), integer) :: map
  def brief(%Core{spec: spec} = core, mono) do
    %{
      id: spec.id,
      network: spec.network,
      kind: spec.kind,
      url: spec.text,
      spec: spec,
      label: spec.options[:label],
      high_latency: spec.options[:high_latency] || false,
      status: status(core, mono),
      text: text(core, mono),
      reason: core.reason,
      since: core.since,
      retry_in_ms: if(core.phase == :down, do: max(core.retry_at - mono, 0)),
      local: core.info[:local],
      port: core.info[:port],
      peer: core.info[:peer],
      baud: core.info[:baud],
      finding: core.info[:finding],
      diagnosis: core.diagnosis,
      last_heard: core.last_heard,
      overload: core.overload && Map.take(core.overload, [:since, :datagrams]),
      behind: core.behind && %{since: core.behind.since, frames: core.behind.datagrams},
      counters: Core.counters(core),
      rates: Rates.per_second(core.rates)
    }
  end

  defp peers(peers, mono) do
    for {id, peer} <- Enum.take(peers.map, Store.Links.max_peers()) do
      stats = Peer.measure(peer).stats

      %{
        peer: id,
        text: peer.text,
        silent_ms: mono - peer.heard,
        frames_in: stats.frames,
        bytes_in: stats.bytes
      }
    end
  end

  @doc "The status at a monotonic time in ms."
  @spec status(Core.t(), integer) :: status
  def status(%Core{phase: :up} = core, mono) do
    if mono - (core.heard || core.opened) >= core.idle_ms, do: :idle, else: :up
  end

  def status(%Core{phase: :idle}, _mono), do: :connecting
  def status(%Core{phase: phase}, _mono), do: phase

  @doc "The status in words."
  @spec text(Core.t(), integer) :: String.t()
  def text(%Core{phase: :down} = core, mono) do
    "#{core.reason}, next try #{Reason.wait(max(core.retry_at - mono, 0))}"
  end

  def text(%Core{phase: :ended} = core, _mono), do: core.reason

  def text(%Core{phase: :up, diagnosis: [finding | _]}, _mono) do
    "connected, but no MAVLink on #{Finding.format(finding)}"
  end

  def text(%Core{phase: :up, overload: %{datagrams: n}} = core, mono) do
    text(%{core | overload: nil}, mono) <>
      ", overloaded: #{n} datagrams came faster than they could be read and were dropped"
  end

  def text(%Core{phase: :up, behind: %{datagrams: n}} = core, mono) do
    text(%{core | behind: nil}, mono) <>
      ", overloaded: #{n} frames came faster than their vehicle's session took them and were dropped"
  end

  def text(%Core{phase: :up, spec: spec} = core, mono) do
    quiet = if status(core, mono) == :idle, do: ", nothing heard", else: ""

    cond do
      spec.server -> "listening on #{core.info[:local]}#{quiet}"
      spec.recorded -> "replaying #{Spec.place(spec)}#{quiet}"
      true -> "connected to #{place(core)}#{quiet}"
    end
  end

  def text(%Core{} = core, _mono) do
    again = if core.reason, do: " again (#{core.reason})", else: ""
    "connecting to #{Spec.place(core.spec)}#{again}"
  end

  defp place(core), do: core.info[:peer] || Spec.place(core.spec)
end
