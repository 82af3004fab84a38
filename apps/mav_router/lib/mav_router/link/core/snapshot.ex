defmodule MavRouter.Link.Core.Snapshot do
  @moduledoc """
  What everybody may know about a link. The link's process publishes it in `Aerie.Base.Store`: `brief/2` as a whole, of `:peers`
  and `:sources` only what changed (`MavRouter.Link.Peers.PublishedPeers`). `Aerie.Base.Store.Links` puts them together.

  `fields/0` says what people are shown, and what it means; times are unix microseconds here. These keys are for the gateway
  alone:

  | key | value |
  |---|---|
  | `:spec` | `MavRouter.Link.Spec` |
  | `:baud` | of an open serial port |
  | `:finding` | how an open serial port was found, if it was searched for (`MavRouter.Link.Serial.Finding`) |
  | `:diagnosis` | why serial ports do not work: findings with evidence and advice, otherwise empty |
  | `:peers` | also `peer`, its id; at most 1,024 of them |
  | `:sources` | `%{{system, component} => %{received, lost, ratio, …}}`, loss by sequence numbers (R7, R9) |
  | `:restarts` | monotonic ms of the last restarts of the link's process |
  | `:high_latency` | whether it is configured as a high-latency link (`MavCodec.Meaning.HighLatency`) |
  """

  alias Aerie.Base.Json.Object
  alias MavRouter.Link.Core
  alias MavRouter.Link.Peers.Peer
  alias MavRouter.Link.Peers
  alias MavRouter.Link.Core.Rates
  alias MavRouter.Link.Reason
  alias MavRouter.Link.Serial.Finding
  alias MavRouter.Link.Spec
  alias Aerie.Base.Store

  @peer Object.fields([
          {:text, :text, nil, "its address"},
          {:silent_ms, :integer, "ms", "since it was heard"},
          {:frames_in, :integer, nil, "good frames received"},
          {:bytes_in, :integer, "B", "bytes received"}
        ])
  @rates Object.fields([
           {:bytes_in, 1, "B/s", "received in the last second"},
           {:bytes_out, 1, "B/s", "sent"},
           {:frames_in, 1, "1/s", "good frames received"},
           {:writes_out, 1, "1/s", "writes: frames and batches of frames"},
           {:crc_errors, 1, "1/s", "frames with a wrong checksum"}
         ])
  @quality Object.fields([
             {:score, 1, nil, "how good the link is, from 0 to 100", metric: "gateway_link_score"},
             {:loss, 3, "0..1", "share of frames lost on it in the last seconds, 0 to 1",
              metric: "gateway_link_loss_ratio"},
             {:rtt_ms, 1, "ms", "round trip"},
             {:age_ms, 0, "ms", "since the last frame"},
             {:group, :text, nil, "the links that are redundant with it"},
             {:carries, :boolean, nil, "whether this link carries for the group"}
           ])
  @overload Object.fields([
              {:since, :time, nil, "since when"},
              {:datagrams, :integer, nil, "how many were dropped"}
            ])
  @behind Object.fields([
            {:since, :time, nil, "since when"},
            {:frames, :integer, nil, "how many were dropped"}
          ])
  @fields Object.fields([
            {:id, :text, nil, "name"},
            {:network, :text, nil, "the network that its system ids belong to"},
            {:kind, :text, nil, "udp_server, tcp_client, serial, replay …"},
            {:url, :text, nil, "connection string"},
            {:label, :text, nil, "label from the configuration"},
            {:status, {:one_of, [:connecting, :up, :idle, :down, :ended]}, nil,
             "connecting, up, idle (up, but nothing was heard for a while), down or ended"},
            {:text, :text, nil, "the status in words"},
            {:reason, :text, nil, "why the link is not up"},
            {:retry_in_ms, 0, "ms", "until the next try"},
            {:since, :time, nil, "time since which it has this status"},
            {:last_heard, :time, nil, "time of the last frame"},
            {:local, :text, nil, "own address, or the device"},
            {:port, :integer, nil, "own port"},
            {:peer, :text, nil, "address of the peer"},
            {:peers, {:list, {:object, @peer}}, nil, "peers of a server:"},
            {:signing, {:object, MavRouter.Signing.link_fields()}, nil,
             "signatures, if there is any key (signing.md):"},
            {:recording, {:object, MavRouter.Recorder.fields()}, nil, "how it is recorded (recordings.md):"},
            {:overload, {:object, @overload}, nil,
             "while datagrams come faster than they are read, and for 10 s after:"},
            {:behind, {:object, @behind}, nil,
             "while a vehicle's session does not keep up with its frames, and for 10 s after:"},
            {:rates, {:object, @rates}, nil, "per second:"},
            {:quality, {:object, @quality}, nil, "how good the link is:"},
            {:counters, {:object, Core.Counters.fields()}, nil,
             "what was counted since the gateway was started:"}
          ])

  @type status :: :connecting | :up | :idle | :down | :ended

  @doc "What is shown of a snapshot."
  @spec fields :: [Object.t()]
  def fields, do: @fields

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
