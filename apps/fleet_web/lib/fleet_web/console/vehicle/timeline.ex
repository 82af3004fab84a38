defmodule FleetWeb.Console.Vehicle.Timeline do
  @moduledoc "A vehicle's events and texts as lines that can be filtered by severity. Pure."

  alias Aerie.Vehicle.Event

  @max 200
  @levels [all: 7, notice: 5, warning: 4, error: 3]

  # MAV_SEVERITY of events that are not texts; all others are information.
  @severity %{
    "failsafe" => 2,
    "kill_switch.engaged" => 1,
    "battery.critical" => 2,
    "position.lost" => 2,
    "collision" => 2,
    "geofence" => 3,
    "link.lost" => 3,
    "gps.lost" => 3,
    "rc.lost" => 3,
    "signing.rejected" => 3,
    "signing.failed" => 3,
    "battery.low" => 4,
    "gcs.lost" => 4,
    "gcs_failsafe" => 4,
    "reboot" => 4,
    "events.suppressed" => 4,
    "stream.contested" => 4,
    "armed" => 5,
    "disarmed" => 5,
    "takeoff" => 5,
    "landed" => 5,
    "mode_change" => 5,
    "failsafe.cleared" => 5,
    "geofence.cleared" => 5,
    "link.restored" => 5,
    "mission.completed" => 5
  }
  @names ~w(emergency alert critical error warning notice info debug)

  @typedoc "`:tone` of `severity` (0 emergency to 7 debug): `:bad` to 3, `:warn` for 4, `:plain` for the rest."
  @type line :: %{
          id: String.t(),
          time: integer(),
          type: String.t(),
          severity: 0..7,
          name: String.t(),
          tone: :bad | :warn | :plain,
          text: String.t()
        }

  @doc "The levels to choose from, by name."
  @spec levels() :: [String.t()]
  def levels, do: for({name, _least} <- @levels, do: Atom.to_string(name))

  @doc "The lines of events, newest first, at most #{@max}. `level`: one of `levels/0`; `search`: a part of the type or text."
  @spec lines([Event.t()], level :: String.t(), search :: String.t()) :: [line()]
  def lines(events, level \\ "all", search \\ "") do
    least = for({name, least} <- @levels, Atom.to_string(name) == level, do: least) |> List.first(7)
    search = String.downcase(search)

    events
    |> Enum.reverse()
    |> Stream.map(&line/1)
    |> Stream.filter(
      &(&1.severity <= least and String.contains?(String.downcase("#{&1.type} #{&1.text}"), search))
    )
    |> Enum.take(@max)
  end

  @doc "The line of an event."
  @spec line(Event.t()) :: line()
  def line(%{type: type, data: data} = event) do
    severity = severity(type, data)

    %{
      id: event.id,
      time: event.time,
      type: type,
      severity: severity,
      name: Enum.at(@names, severity),
      tone: tone(severity),
      text: text(type, data)
    }
  end

  defp severity(type, %{"severity" => severity}) when type in ["statustext", "report"] and severity in 0..7,
    do: severity

  defp severity(type, _data), do: Map.get(@severity, type, 6)

  defp tone(severity) when severity <= 3, do: :bad
  defp tone(4), do: :warn
  defp tone(_severity), do: :plain

  defp text("statustext", data), do: data["text"] || ""
  defp text("mode_change", data), do: "mode #{data["from"] || "unknown"} → #{data["to"]}"
  defp text("armed", data), do: "armed" <> by(data)
  defp text("disarmed", data), do: "disarmed" <> by(data)
  defp text("takeoff", _data), do: "took off"
  defp text("landed", _data), do: "landed"

  defp text("failsafe", data),
    do:
      join("failsafe: #{words(data["reason"] || data["type"])}", [
        action(data["action"]),
        brackets(data["text"])
      ])

  defp text("failsafe.cleared", data), do: "failsafe over: #{words(data["reason"] || data["type"])}"

  defp text("geofence", data),
    do: join("outside the fence", [brackets(data["breach"]), brackets(data["text"])])

  defp text("geofence.cleared", _data), do: "inside the fence again, or the fence is off"
  defp text("rc.lost", _data), do: "remote control lost"
  defp text("rc.restored", _data), do: "remote control restored"
  defp text("gps.lost", data), do: join("GNSS position lost", [brackets(data["fix_name"])])
  defp text("gps.restored", _data), do: "GNSS position restored"
  defp text("position.lost", _data), do: "position estimate lost"
  defp text("position.restored", _data), do: "position estimate restored"
  defp text("kill_switch.engaged", _data), do: "kill switch engaged"
  defp text("kill_switch.released", _data), do: "kill switch released"
  defp text("collision", _data), do: "two vehicles use this system id"
  defp text("gcs.lost", data), do: join("ground station", [data["system"], "lost"])
  defp text("gcs.restored", data), do: join("ground station", [data["system"], "restored"])
  defp text("gcs_failsafe", _data), do: "the vehicle lost its ground station"
  defp text("stream.contested", _data), do: "another program changes the message rates"
  defp text("displaced", data), do: "removed to make room for #{shown(data["by"])}"
  defp text("gateway.started", _data), do: "the gateway started"
  defp text("operator.changed", data), do: charge_of(data["operator"], data["before"], data["reason"])

  defp text("signing.rejected", data),
    do: join("frames without a valid signature rejected", [on(data["link"])])

  defp text("signing.enrolled", data), do: join("signing key set", [by_whom(data["by"])])
  defp text("signing.revoked", data), do: join("signing key removed", [by_whom(data["by"])])

  defp text("signing.failed", data),
    do: join("signing key not changed", [brackets(data["reason"]), by_whom(data["by"])])

  defp text("link.lost", data),
    do: join("contact lost", [data["silent_s"] && "for #{round(data["silent_s"])} s"])

  defp text("link.restored", _data), do: "contact restored"
  defp text("battery.low", data), do: "battery low" <> charge(data)
  defp text("battery.critical", data), do: "battery critical" <> charge(data)
  defp text("param_changed", data), do: "#{data["name"]}: #{shown(data["from"])} → #{shown(data["to"])}"
  defp text("report", data), do: join(words(data["name"] || "report #{data["id"]}"), [values(data["values"])])
  defp text("mission.reached", data), do: "item #{data["seq"]}#{of(data["total"])} reached"
  defp text("mission.completed", _data), do: "mission completed"
  defp text("reboot", _data), do: "the vehicle restarted"
  defp text(type, %{"text" => text}) when is_binary(text) and text != "", do: "#{words(type)}: #{text}"
  defp text(type, data), do: join(words(type), [plain(data)])

  defp charge_of(nil, before, _reason), do: "#{before || "the operator"} is no longer in charge"
  defp charge_of(operator, nil, _reason), do: "#{operator} took charge"

  defp charge_of(operator, before, reason),
    do: join("#{operator} took over from #{before}", [brackets(reason)])

  defp brackets(text) when is_binary(text) and text != "", do: "(#{words(text)})"
  defp brackets(_none), do: nil

  defp on(link) when is_binary(link), do: "on #{link}"
  defp on(_unknown), do: nil

  defp by_whom(name) when is_binary(name), do: "by #{name}"
  defp by_whom(_unknown), do: nil

  defp by(%{"reason" => reason}) when is_binary(reason), do: " (#{words(reason)})"
  defp by(_data), do: ""

  defp action(action) when action in [nil, "none"], do: nil
  defp action(action), do: "→ #{words(action)}"

  defp charge(%{"remaining" => remaining}) when is_number(remaining), do: ": #{round(remaining * 100)} %"
  defp charge(%{"voltage" => volts}) when is_number(volts), do: ": #{shown(volts * 1.0)} V"
  defp charge(_data), do: ""

  defp of(total) when is_integer(total), do: " of #{total}"
  defp of(_unknown), do: ""

  defp values(list) when is_list(list) and list != [],
    do: list |> Enum.take(6) |> Enum.map_join(" ", &shown/1)

  defp values(_none), do: nil

  # The short fields, sorted by name.
  defp plain(data) do
    case for {name, value} <- Enum.sort(data),
             is_binary(value) or is_number(value) or is_boolean(value),
             do: "#{name} #{shown(value)}" do
      [] -> nil
      fields -> fields |> Enum.take(4) |> Enum.join(", ")
    end
  end

  defp join(text, more), do: Enum.join([text | Enum.reject(more, &(&1 in [nil, ""]))], " ")
  defp words(nil), do: "unknown"
  defp words(name), do: name |> to_string() |> String.replace(["_", "."], " ")

  defp shown(number) when is_float(number), do: number |> Float.round(3) |> Aerie.Command.Param.shown()
  defp shown(list) when is_list(list), do: Enum.map_join(list, " ", &shown/1)
  defp shown(nil), do: "unknown"
  defp shown(other) when is_binary(other) or is_number(other) or is_boolean(other), do: to_string(other)
  defp shown(other), do: inspect(other, limit: 5)
end
