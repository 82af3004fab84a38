defmodule Aerie.Api.Metrics.Links do
  @moduledoc "Metric families of links, from their snapshots (`MavRouter.Link.Core.Snapshot`)."

  alias Aerie.Api.Metrics.Text

  @sums [
    bytes_in: {"gateway_link_received_bytes_total", "Bytes received."},
    frames_in: {"gateway_link_received_frames_total", "Frames received that passed their checks."},
    bytes_out: {"gateway_link_sent_bytes_total", "Bytes handed to the transport."},
    writes_out: {"gateway_link_sent_writes_total", "Writes handed to the transport."},
    crc_errors: {"gateway_link_crc_errors_total", "Frames with a wrong CRC."},
    resync_bytes: {"gateway_link_resync_bytes_total", "Bytes skipped in search of the next frame."},
    unknown_ids: {"gateway_link_unknown_messages_total", "Frames whose message id no dialect knows."},
    incompatible:
      {"gateway_link_incompatible_frames_total", "Frames dropped for unknown incompatibility flags (F6)."},
    lost: {"gateway_link_lost_frames_total", "Frames lost, estimated by sequence numbers (R7, R9)."},
    reconnects: {"gateway_link_reconnects_total", "Connections made after the first."},
    restarts: {"gateway_link_restarts_total", "Restarts of the link's process."},
    peers_refused:
      {"gateway_link_refused_peers_total",
       "Connections and datagrams of senders beyond the limit, or of too many new ones at once."},
    routes_refused:
      {"gateway_link_refused_routes_total",
       "Times that a component got no route, because its sender has too many: nothing can be sent to it."}
  ]

  @drops [
    :unclaimed,
    :overload,
    :refused,
    :looped,
    :dropped_out,
    :kernel_dropped,
    :shed,
    :shed_new,
    :denied,
    :withheld
  ]

  @signing [
    verified: {"gateway_link_signing_verified_frames_total", "Frames received with a valid signature."},
    unsigned: {"gateway_link_signing_unsigned_frames_total", "Frames accepted without a signature."},
    rejected:
      {"gateway_link_signing_rejected_frames_total",
       "Frames refused because of a wrong or missing signature."},
    signed: {"gateway_link_signing_signed_frames_total", "Frames that the gateway signed."},
    not_signed:
      {"gateway_link_signing_not_signed_frames_total",
       "Frames that could not be signed: MAVLink 1, or unknown."},
    alarms: {"gateway_link_signing_alarms_total", "Bursts of refused frames."}
  ]

  @doc "The families of these links."
  @spec families([map()]) :: [Text.family()]
  def families(links) do
    [
      {"gateway_mavlink_messages_received_total", :counter, "Good frames received, by message.",
       received(links)},
      {"gateway_mavlink_parse_errors_total", :counter,
       "Frames with a wrong CRC or unknown incompatibility flags.",
       [{[], links |> Enum.map(&(&1.counters.crc_errors + &1.counters.incompatible)) |> Enum.sum()}]},
      {"gateway_link_up", :gauge, "1 while the link is open, whether or not it receives anything.",
       Enum.map(links, &{labels(&1), &1.status in [:up, :idle]})},
      {"gateway_link_overloaded", :gauge,
       "1 while datagrams come faster than they are read, and for 10 s after the last that was dropped.",
       Enum.map(links, &{labels(&1), &1[:overload] != nil})},
      {"gateway_link_behind", :gauge,
       "1 while a vehicle's session does not keep up with the frames of the link, and for 10 s after the last that was dropped.",
       Enum.map(links, &{labels(&1), &1[:behind] != nil})},
      {"gateway_link_peers", :gauge, "Peers of the link.", Enum.map(links, &{labels(&1), length(&1.peers)})}
    ] ++
      quality(for %{quality: %{}} = link <- links, do: link) ++
      for {key, {name, help}} <- @sums do
        {name, :counter, help, Enum.map(links, &{labels(&1), Map.fetch!(&1.counters, key)})}
      end ++
      [
        {"gateway_link_dropped_total", :counter, "Frames and writes dropped, by reason.",
         for(
           link <- links,
           reason <- @drops,
           do: {labels(link) ++ [reason: reason], Map.fetch!(link.counters, reason)}
         )}
      ] ++ signing(for(%{signing: %{}} = link <- links, do: link))
  end

  # Only links with a measurement.
  defp quality(links) do
    gauge = fn name, help, value ->
      {name, :gauge, help, for(link <- links, x = value.(link.quality), x != nil, do: {labels(link), x})}
    end

    [
      gauge.("gateway_link_score", "How good the link is, from 0 to 100.", & &1.score),
      gauge.(
        "gateway_link_loss_ratio",
        "Share of frames lost on it in the last seconds, 0 to 1.",
        & &1.loss
      ),
      gauge.(
        "gateway_link_round_trip_seconds",
        "Round-trip time measured on it.",
        &(&1.rtt_ms && &1.rtt_ms / 1000)
      ),
      {"gateway_link_carries", :gauge,
       "1 while it is the link of its group that carries traffic to vehicles.",
       for(
         %{quality: %{group: group} = quality} = link <- links,
         group != nil,
         do: {labels(link), quality.carries}
       )}
    ]
  end

  # Only links with a key.
  defp signing(links) do
    unsafe =
      {"gateway_link_signing_unsafe", :gauge,
       "1 while the link accepts frames that anybody could have sent (S11).",
       Enum.map(links, &{labels(&1), &1.signing.unsafe})}

    sums =
      for {key, {name, help}} <- @signing,
          do: {name, :counter, help, Enum.map(links, &{labels(&1), Map.fetch!(&1.signing, key)})}

    [unsafe | sums]
  end

  @doc "The name of a message as a label: `global_position_int`, or `unknown`."
  @spec message_name(non_neg_integer() | :other) :: String.t()
  def message_name(:other), do: "unknown"

  def message_name(id) do
    case MavCodec.Dialects.All.name(id) do
      nil -> "unknown"
      name -> String.downcase(name)
    end
  end

  defp received(links) do
    for(link <- links, {id, n} <- link.counters.messages, do: {message_name(id), n})
    |> Enum.reduce(%{}, fn {name, n}, sums -> Map.update(sums, name, n, &(&1 + n)) end)
    |> Enum.sort()
    |> Enum.map(fn {name, n} -> {[type: name], n} end)
  end

  defp labels(link), do: [link: link.id, network: link.network]
end
