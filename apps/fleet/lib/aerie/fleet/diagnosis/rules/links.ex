defmodule Aerie.Fleet.Diagnosis.Rules.Links do
  @moduledoc "Rules for links: whether anything arrives, whether it is MAVLink, and how much of it is lost."

  @behaviour Aerie.Fleet.Diagnosis.Rules

  import Aerie.Fleet.Diagnosis.Rules, only: [grown: 3]

  alias Aerie.Fleet.Diagnosis.Condition

  @silent_us 10_000_000
  # This many bytes without a frame cannot be MAVLink: the longest frame has 297.
  @bytes 600
  @noisy 0.02
  @least_errors 10
  @lossy 0.1

  @impl true
  def names do
    [
      link_down: "a link cannot connect",
      link_silent: "a link is connected, but nothing arrives",
      wrong_protocol: "a link receives bytes, but no MAVLink frame",
      no_vehicle: "a link receives MAVLink, but no autopilot's heartbeat",
      noisy_link: "many frames on a link have wrong checksums",
      lossy_link: "many frames on a link are lost"
    ]
  end

  @impl true
  def check(%{links: links} = facts) do
    for link <- links, link.kind != :replay, condition <- line(link, facts), do: condition
  end

  # Serial ports explain their own problems (`Rules.Serial`).
  defp line(%{status: :down, diagnosis: []} = link, _facts) do
    condition(link, :link_down, :error, "#{link.id} cannot connect",
      evidence: [link.reason || link.text],
      mend: "Check the address #{link.url} and whether the other end runs; the gateway tries again by itself."
    )
  end

  defp line(%{status: status} = link, facts) when status in [:up, :idle] do
    grown = &grown(facts, {:link, link.id}, &1)

    cond do
      link.diagnosis != [] -> []
      grown.(:bytes_in) >= @bytes and grown.(:frames_in) == 0 -> other_protocol(link, facts, grown)
      silent?(link, facts) -> silent(link, facts)
      true -> no_vehicle(link, facts) ++ quality(link, facts, grown)
    end
  end

  defp line(_connecting, _facts), do: []

  defp other_protocol(link, facts, grown) do
    condition(link, :wrong_protocol, :error, "#{link.id} receives bytes that are not MAVLink",
      evidence: ["#{grown.(:bytes_in)} bytes in #{facts.seconds} s, no MAVLink frame"],
      mend:
        "Configure the other end to send MAVLink (ArduPilot: SERIALn_PROTOCOL 2, PX4: MAV_n_CONFIG), or use its telemetry port."
    )
  end

  defp silent?(%{last_heard: nil, since: since}, facts), do: facts.now - since >= @silent_us
  defp silent?(%{last_heard: at}, facts), do: facts.now - at >= @silent_us

  defp silent(%{spec: %{server: true}, last_heard: nil} = link, _facts) do
    condition(link, :link_silent, :notice, "#{link.id} waits for a vehicle to connect",
      evidence: [link.text],
      mend:
        "Configure the vehicle or its radio to send to port #{link.port} of this machine; check the firewall."
    )
  end

  defp silent(link, facts) do
    condition(link, :link_silent, :warning, "nothing arrives on #{link.id}",
      evidence: [
        link.text,
        silence(link, facts),
        "#{grown(facts, {:endpoints, link.id}, :frames_out)} frames sent in #{facts.seconds} s"
      ],
      mend: "Check the vehicle's power and range; on a cable, check that TX and RX are crossed."
    )
  end

  defp silence(%{last_heard: nil}, _facts), do: "never heard anything"
  defp silence(%{last_heard: at}, facts), do: "last frame #{div(facts.now - at, 1_000_000)} s ago"

  defp no_vehicle(link, facts) do
    if link.sources != %{} and not Enum.any?(facts.vehicles, &(link.id in &1.links)) and
         facts.now - link.since >= @silent_us do
      ids = for {{system, component}, _loss} <- Enum.sort(link.sources), do: "#{system}/#{component}"

      condition(link, :no_vehicle, :notice, "#{link.id} receives MAVLink, but hears no autopilot",
        evidence: ["systems/components heard: #{ids |> Enum.take(8) |> Enum.join(", ")}"],
        mend:
          "Check whether this is a radio whose vehicle is off, or a ground station. An autopilot has to send HEARTBEAT on this link."
      )
    else
      []
    end
  end

  defp quality(link, facts, grown) do
    errors = grown.(:crc_errors)
    frames = grown.(:frames_in)
    loss = get_in(link, [:quality, Access.key(:loss)])

    cond do
      errors >= @least_errors and errors > (frames + errors) * @noisy ->
        condition(
          link,
          :noisy_link,
          :warning,
          "#{percent(errors / (frames + errors))} of the frames on #{link.id} are damaged",
          evidence: ["#{errors} wrong checksums and #{frames} good frames in #{facts.seconds} s"],
          mend:
            "Shorten or shield the cable, check the ground, lower the baud rate; for a radio, its antenna and its air rate."
        )

      is_number(loss) and loss > @lossy ->
        condition(link, :lossy_link, :warning, "#{percent(loss)} of the frames on #{link.id} are lost",
          evidence: ["sequence numbers of the last seconds; #{round_trip(link)}"],
          mend:
            "Lower the stream rates or raise the radio's rate; check antennas; a second link with the same group helps."
        )

      true ->
        []
    end
  end

  defp round_trip(%{quality: %{rtt_ms: ms}}) when is_number(ms), do: "round trip #{round(ms)} ms"
  defp round_trip(_link), do: "no round trip measured"

  defp percent(share), do: "#{round(share * 100)} %"

  defp condition(link, name, severity, title, fields),
    do: [Condition.new(name, severity, {:link, link.id}, [title: title] ++ fields)]
end
