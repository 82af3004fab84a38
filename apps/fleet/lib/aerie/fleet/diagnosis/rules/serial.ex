defmodule Aerie.Fleet.Diagnosis.Rules.Serial do
  @moduledoc "Rules for serial ports: what a link found by listening (`MavRouter.Link.Serial.Finding`)."

  @behaviour Aerie.Fleet.Diagnosis.Rules

  alias Aerie.Fleet.Diagnosis.Condition
  alias MavRouter.Link.Serial.Finding

  # condition of a finding => name, severity, what it means
  @names %{
    noise: {:wrong_baud, :error, "a serial port receives bytes that make no sense at its baud rate"},
    other_protocol: {:wrong_protocol, :error, "a serial port receives another protocol than MAVLink"},
    no_permission: {:serial_permission, :error, "the gateway may not open a serial port"},
    in_use: {:serial_busy, :error, "another program has a serial port open"},
    absent: {:serial_absent, :error, "a serial port does not exist, or was unplugged"},
    not_serial: {:serial_absent, :error, "a serial port does not exist, or was unplugged"},
    fault: {:serial_fault, :error, "a serial port fails"},
    silent: {:serial_silent, :warning, "a serial port receives nothing"},
    no_heartbeat: {:no_heartbeat, :warning, "a serial port receives MAVLink, but no autopilot's heartbeat"}
  }

  @impl true
  def names, do: for({_condition, {name, _severity, meaning}} <- @names, uniq: true, do: {name, meaning})

  @impl true
  def check(%{links: links}) do
    for %{diagnosis: [_ | _] = findings} = link <- links,
        {condition, findings} <- Enum.group_by(findings, & &1.condition),
        {name, severity, _meaning} <- List.wrap(@names[condition]),
        do: condition(link, name, severity, findings)
  end

  defp condition(link, name, severity, [finding | _] = findings) do
    Condition.new(name, severity, {:link, link.id},
      title: title(name, link, finding),
      evidence: Enum.map(findings, &Finding.format/1),
      mend: mend(name, finding)
    )
  end

  defp title(:wrong_baud, link, finding),
    do: "#{link.id}: the baud rate of #{finding.path} is wrong, or its signal is not serial data"

  defp title(:wrong_protocol, link, finding),
    do: "#{link.id}: #{finding.path} does not speak MAVLink"

  defp title(:serial_permission, link, finding), do: "#{link.id}: no permission to open #{finding.path}"
  defp title(:serial_busy, link, finding), do: "#{link.id}: #{finding.path} is in use"
  defp title(:serial_absent, link, finding), do: "#{link.id}: there is no serial port #{finding.path}"
  defp title(:serial_fault, link, finding), do: "#{link.id}: #{finding.path} fails"
  defp title(:serial_silent, link, finding), do: "#{link.id}: #{finding.path} receives nothing"
  defp title(:no_heartbeat, link, finding), do: "#{link.id}: no autopilot is heard on #{finding.path}"

  # A port with a configured rate is not searched. Without the rate it is.
  defp mend(:wrong_baud, %{path: path} = finding),
    do:
      "Leave out the baud rate (serial:#{path}) to have it detected, or use that of the vehicle's SERIALn_BAUD or " <>
        "SER_TELn_BAUD. #{sentence(finding.advice)}"

  defp mend(:serial_absent, _finding),
    do: "Plug it in, or configure another port (ls -l /dev/serial/by-id); serial:auto finds it."

  defp mend(_name, %{advice: advice}) when advice != nil, do: sentence(advice)
  defp mend(_name, _finding), do: "Check the cable, the port and its power."

  defp sentence(nil), do: ""

  defp sentence(text),
    do:
      String.replace_suffix(String.capitalize(String.first(text)) <> String.slice(text, 1..-1//1), ".", "") <>
        "."
end
