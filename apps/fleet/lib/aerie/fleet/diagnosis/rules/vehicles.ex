defmodule Aerie.Fleet.Diagnosis.Rules.Vehicles do
  @moduledoc "Rules for vehicles that are heard: whether they hear us, send the streams that are wanted, and have an id of their own."

  @behaviour Aerie.Fleet.Diagnosis.Rules

  import Aerie.Fleet.Diagnosis.Rules, only: [grown: 3]

  alias Aerie.Fleet.Diagnosis.Condition
  alias MavCodec.Dialects.All

  # Time for TIMESYNC and three tries at each stream.
  @settled_ms 20_000
  @unmet [:short, :missing]

  @impl true
  def names do
    [
      two_vehicles_one_id: "two vehicles use one system id",
      own_id_taken: "a vehicle has the gateway's own system id",
      one_way_link: "a vehicle is heard, but answers nothing",
      mavlink1_only: "a vehicle speaks MAVLink 1",
      no_streams: "a vehicle answers, but does not send its telemetry",
      contested_streams: "a vehicle keeps other stream rates than the gateway asked for",
      gcs_id_mismatch: "a vehicle's failsafe listens to a ground station that is not there",
      signing_refused: "all frames of a vehicle are refused because of their signatures"
    ]
  end

  @impl true
  def check(facts) do
    for %{status: :online} = vehicle <- facts.vehicles,
        rule <- rules(),
        condition <- rule.(vehicle, facts),
        do: condition
  end

  defp rules, do: [&collision/2, &own_id/2, &version/2, &streams/2, &contested/2, &station/2, &signing/2]

  defp collision(%{collision: %{sign: "claim", links: links}} = vehicle, _facts) do
    title = "somebody else sends as system id #{vehicle.system_id} (#{vehicle.id})"

    condition(vehicle, :two_vehicles_one_id, :error, title,
      evidence: [
        "the vehicle is heard by #{names(Enum.at(links, 0))}",
        "frames under its id come by #{names(Enum.at(links, 1))} as well; they reach nobody"
      ],
      mend:
        "Find out who that is. A second radio of the same vehicle belongs to the group of the first (links: group), " <>
          "and another vehicle needs another id or a network of its own."
    )
  end

  defp collision(%{collision: %{sign: sign, links: links}} = vehicle, _facts) do
    title = "two vehicles use system id #{vehicle.system_id} (#{vehicle.id})"

    condition(vehicle, :two_vehicles_one_id, :error, title,
      evidence: [
        "#{sign(sign)} alternates between two values",
        "one is heard by #{names(Enum.at(links, 0))}, the other by #{names(Enum.at(links, 1))}"
      ],
      mend:
        "Give one of them another id (ArduPilot: MAV_SYSID or SYSID_THISMAV, PX4: MAV_SYS_ID), or put its link into a network of its own. " <>
          "Until then #{vehicle.id} is the one that was heard first."
    )
  end

  defp collision(_vehicle, _facts), do: []

  defp sign({:boot_time, id}), do: "the boot time in #{All.name(id) || id}"
  defp sign(other), do: "the #{other}"

  defp names(links) when is_list(links) and links != [], do: links |> Enum.map_join(", ", &link_name/1)
  defp names(_none), do: "the same link"

  defp link_name({link, peer}), do: "#{link} (#{if is_binary(peer), do: peer, else: inspect(peer)})"
  defp link_name(link), do: "#{link}"

  # A companion shares the id of its vehicle on purpose; then its component is 191 and the vehicle is the only one.
  defp own_id(%{system_id: system} = vehicle, %{identity: %{system: system, component: component}} = facts)
       when length(facts.vehicles) > 1 do
    condition(vehicle, :own_id_taken, :warning, "#{vehicle.id} has the gateway's own system id #{system}",
      evidence: [
        "the gateway is #{system}/#{component}, and #{length(facts.vehicles)} vehicles are known, so it is a hub"
      ],
      mend:
        "Give the gateway another mavlink.system_id, or the vehicle another id: other programs take the gateway for a part of that vehicle."
    )
  end

  defp own_id(_vehicle, _facts), do: []

  defp version(%{mavlink_version: 1} = vehicle, facts) do
    if settled?(vehicle, facts) do
      condition(vehicle, :mavlink1_only, :notice, "#{vehicle.id} speaks MAVLink 1",
        evidence: ["its heartbeats are in version 1, though it got ours in version 2"],
        mend:
          "Set SERIALn_PROTOCOL 2 (ArduPilot) or MAV_PROTO_VER 2 (PX4). Without MAVLink 2 there are no signatures, no messages above id 255, " <>
            "no fences, rally points or parameters of cameras."
      )
    else
      []
    end
  end

  defp version(_vehicle, _facts), do: []

  defp streams(%{streams: %{} = streams} = vehicle, facts) do
    unmet = for {id, %{state: state}} <- streams, state in @unmet, do: id
    answered? = match?(%{samples: n} when n > 0, vehicle.clock)

    cond do
      recorded?(vehicle, facts) or vehicle.high_latency.only? or not settled?(vehicle, facts) ->
        []

      not answered? and vehicle.firmware == nil and sent(vehicle, facts) > 0 ->
        one_way(vehicle, facts, unmet)

      length(unmet) >= 3 and length(unmet) * 2 > map_size(streams) ->
        no_streams(vehicle, unmet, streams)

      true ->
        []
    end
  end

  defp streams(_vehicle, _facts), do: []

  defp one_way(vehicle, facts, unmet) do
    condition(vehicle, :one_way_link, :error, "#{vehicle.id} is heard, but answers nothing",
      evidence: [
        "#{sent(vehicle, facts)} frames sent by #{names(vehicle.links)} in #{facts.seconds} s",
        "no answer to TIMESYNC, PING or the request for AUTOPILOT_VERSION",
        "#{length(unmet)} requested messages do not arrive"
      ],
      mend:
        "Its frames reach us, but ours do not reach it. Check the wire from our TX to its RX, the radio's other direction, and for UDP that " <>
          "answers reach the vehicle (firewall, one-way forwarding). A vehicle with a signing key ignores unsigned frames."
    )
  end

  defp no_streams(vehicle, unmet, streams) do
    condition(
      vehicle,
      :no_streams,
      :warning,
      "#{vehicle.id} answers, but does not send the requested telemetry",
      evidence: [
        "#{length(unmet)} of #{map_size(streams)} requested messages: #{unmet |> Enum.sort() |> Enum.take(6) |> Enum.map_join(", ", &(All.name(&1) || &1))}"
      ],
      mend:
        "Check the stream rates of its port (ArduPilot: SRn_* and bit 12 of SERIALn_OPTIONS, PX4: MAV_n_MODE, MAV_n_RATE) and whether the " <>
          "link is fast enough."
    )
  end

  defp contested(%{streams: %{} = streams} = vehicle, _facts) do
    case for {id, %{state: :yielded} = stream} <- streams, do: {id, stream} do
      [] ->
        []

      yielded ->
        condition(
          vehicle,
          :contested_streams,
          :notice,
          "#{vehicle.id} keeps other stream rates than the gateway asked for",
          evidence:
            for(
              {id, stream} <- Enum.take(yielded, 6),
              do: "#{All.name(id) || id}: requested #{hz(stream.wanted)}, measured #{hz(stream.measured)}"
            ),
          mend:
            "Look first whether its link loses data. Otherwise another program changes them: connect that to the gateway rather than to the " <>
              "vehicle, or set the rate there. The gateway has stopped asking."
        )
    end
  end

  defp contested(_vehicle, _facts), do: []

  defp hz(nil), do: "any rate"
  defp hz(hz), do: "#{Float.round(hz / 1, 1)} Hz"

  # H5: a failsafe whose ground station is not there triggers without cause, or never does.
  defp station(%{gcs: %{failsafe_range: {low, high}, known_by: [_ | _] = heard} = gcs} = vehicle, _facts) do
    if gcs.enabled? != false and not Enum.any?(gcs.stations, & &1.keeps?) do
      condition(
        vehicle,
        :gcs_id_mismatch,
        :warning,
        "the ground-station failsafe of #{vehicle.id} listens to an id that no ground station has",
        evidence: [
          "it listens to #{if low == high, do: low, else: "#{low} to #{high}"}#{if gcs.enabled?, do: ", and is enabled"}",
          "ground stations heard: #{Enum.join(heard, ", ")}"
        ],
        mend:
          "Set the ground station's system id to #{low}, or the vehicle's MAV_GCS_SYSID (SYSID_MYGCS before 4.7) to #{hd(heard)}."
      )
    else
      []
    end
  end

  defp station(_vehicle, _facts), do: []

  defp signing(%{signing: %{state: :rejected} = signing} = vehicle, _facts) do
    condition(
      vehicle,
      :signing_refused,
      :error,
      "all frames of #{vehicle.id} are refused: none has a valid signature",
      evidence: ["key #{signing.key}, #{signing.rejected} frames refused"],
      mend: "The vehicle has another key or none: enrol it again, or configure its key under signing."
    )
  end

  defp signing(_vehicle, _facts), do: []

  defp settled?(%{id: id}, facts), do: Map.get(facts.online_ms, id, 0) >= @settled_ms

  defp recorded?(%{links: links}, facts) do
    recorded = for %{kind: :replay, id: id} <- facts.links, do: id
    links != [] and Enum.all?(links, &(&1 in recorded))
  end

  defp sent(%{links: links}, facts),
    do: links |> Enum.map(&grown(facts, {:endpoints, &1}, :frames_out)) |> Enum.sum()

  defp condition(vehicle, name, severity, title, fields),
    do: [Condition.new(name, severity, {:vehicle, vehicle.id}, [title: title] ++ fields)]
end
