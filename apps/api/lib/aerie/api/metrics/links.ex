defmodule Aerie.Api.Metrics.Links do
  @moduledoc "Metric families of links, from their snapshots (`MavRouter.Link.Core.Snapshot`)."

  alias Aerie.Api.Metrics.Text
  alias Aerie.Base.Json.Object

  @counters Object.inside(MavRouter.Link.fields(), :counters)
  @drops for %{metric: nil, name: name} <- @counters, do: name
  @sums Object.metrics(@counters)
  @quality MavRouter.Link.fields() |> Object.inside(:quality) |> Object.metrics()
  @signing MavRouter.Link.fields() |> Object.inside(:signing) |> Object.metrics()

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
      sums(@sums, :counter, links, & &1.counters) ++
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
    sums(@quality, :gauge, links, & &1.quality) ++
      [
        {"gateway_link_round_trip_seconds", :gauge, "Round-trip time measured on it.",
         for(%{quality: %{rtt_ms: ms}} = link <- links, do: {labels(link), ms && ms / 1000})},
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

    [unsafe | sums(@signing, :counter, links, & &1.signing)]
  end

  defp sums(fields, kind, links, counts) do
    for {%{name: key}, name, help} <- fields,
        do: {name, kind, help, Enum.map(links, &{labels(&1), Map.fetch!(counts.(&1), key)})}
  end

  defp received(links) do
    for(link <- links, {id, n} <- link.counters.messages, do: {MavRouter.Link.message_name(id), n})
    |> Enum.reduce(%{}, fn {name, n}, sums -> Map.update(sums, name, n, &(&1 + n)) end)
    |> Enum.sort()
    |> Enum.map(fn {name, n} -> {[type: name], n} end)
  end

  defp labels(link), do: [link: link.id, network: link.network]
end
