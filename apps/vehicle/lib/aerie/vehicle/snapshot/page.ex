defmodule Aerie.Vehicle.Snapshot.Page do
  @moduledoc """
  `docs/telemetry.md`, made from `Aerie.Vehicle.State.Fields`, `Aerie.Vehicle.Snapshot.Fields`,
  `MavRouter.Link.fields/0` and `Aerie.Vehicle.Event.Types` (`mix aerie.telemetry`), so that the page cannot
  differ from what is published.
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.{Event, Snapshot}
  alias Aerie.Vehicle.State.Fields

  @doc "The text of the page."
  @spec markdown() :: String.t()
  def markdown do
    [short, listed, whole] = Enum.map([:short, :listed, :whole], &Snapshot.Fields.of/1)

    [
      intro(),
      "\n## State\n\n",
      state(),
      for({group, title, fields} <- Fields.all(), do: group(group, title, fields)),
      "\n## A vehicle\n\nThe object of `state.sock`:\n\n",
      object(short),
      "\n`GET /api/status` and `GET /api/vehicles` add:\n\n",
      object(listed -- short),
      "\n`GET /api/vehicles/ID` adds:\n\n",
      object(whole -- listed),
      "\n## A link\n\nThe objects of `GET /api/links`:\n\n",
      object(MavRouter.Link.fields()),
      "\n## Events\n\n",
      events(),
      for(type <- Event.Types.all(), do: event(type))
    ]
    |> IO.iodata_to_binary()
  end

  defp intro do
    """
    # Telemetry: every field, its unit, its meaning

    <!-- Made by `mix aerie.telemetry` from Aerie.Vehicle.State.Fields and Aerie.Vehicle.Event.Types: change those, not this page. -->

    A field has the same name, unit and number of decimals in NATS, REST and `state.sock`.

    - Units are SI, with degrees for angles and positions. A ratio is 0..1, never per cent. A height says above what.
    - null means "not known". A value that is not updated any more stays and has an age.
    - `time` is ISO 8601 in UTC with milliseconds, by the gateway's clock. `time_boot_ms` is the vehicle's own clock,
      milliseconds since its boot. `timestamp` is the unix time of the response in seconds. `age` is in seconds.
    - `gateway` is the name of the gateway that published a value; two may hear the same vehicle.
    - `epoch` increases with each start of the gateway: a new epoch means that it was restarted. An event's `seq` begins at 1 in
      each epoch. With `nats.mode: off` the gateway keeps nothing between its starts: `epoch` is the unix time of the start in
      milliseconds, which grows as long as the clock is not set back, and no event tells what changed while the gateway was off (`found`
      with `since`).
    - Numbers are rounded when they are published, not before.

    | where | what |
    |---|---|
    | NATS `fleet.{environment}.{vehicle}.state.{group}` | `vehicle`, `group`, `gateway`, `epoch`, `time`, `time_boot_ms`, `data`: a group below |
    | NATS `fleet.{environment}.{vehicle}.event.{type}` | `id`, `vehicle`, `type`, `epoch`, `seq`, `time`, `time_boot_ms`, `data`: an event below |
    | NATS `fleet.{environment}.{vehicle}.state.gateway` | the same; `data` is what the gateway knows of the vehicle: `network`, `system_id`, `autopilot`, `type`, `firmware`, `status`, and `silent_s`, how long it was silent |
    | `GET /api/vehicles/ID` | `groups`, each with `time`, `age`, `via`, `time_boot_ms`, `data`; and the vehicle below |
    | `GET /api/vehicles/ID/events`, `GET /api/events` | the latest events, each as in NATS |
    | `GET /api/links` | a link below |
    | `state.sock`, `GET /api/status` | the most used fields of some groups, with `ages` |

    The configuration's `sampling` sets how often a group is published. With the strategy `aggregate`, a group has `min` and
    `max` of each number and the number of `samples`, besides the means.
    """
  end

  defp state,
    do: "Sources are MAVLink messages. If several carry the same value, the best one that comes is used.\n"

  defp group(group, title, fields) do
    rows =
      for field <- fields do
        name = Enum.map_join(field.path, ".", &Atom.to_string/1)
        row(["`#{name}`", field.unit, decimals(field), field.meaning, field.source])
      end

    ["\n### #{group}\n\n", title, "\n\n", header(~w(field unit decimals meaning source)), rows]
  end

  defp object(fields),
    do: [
      header(~w(field unit meaning)),
      for({name, unit, meaning} <- Object.rows(fields), do: row(["`#{name}`", unit, meaning]))
    ]

  defp decimals(%{decimals: nil}), do: nil
  defp decimals(%{decimals: n}), do: Integer.to_string(n)

  defp events do
    """
    Events are delivered at least once, in the order of `seq`. An event that is delivered twice has the same `id`. `time` is when
    the gateway received what shows the event. It may step back by a few seconds from one event to the next, because a `failsafe`
    waits for its cause, a `report` for those before it, and a change that may be another vehicle's until it has stayed. The `time`
    of a `report` with `late_s`, most often one that was lost and requested again, is when it happened by the vehicle's clock: up
    to an hour before. Sort by `epoch` and `seq`, not by `time`.

    The data of an event that the vehicle's state shows may also have `position` (`lat`, `lon`, `alt_msl`, `alt_rel` as above):
    where the vehicle was then.

    `events.suppressed` tells how many events were over the budget of their type. A vehicle that sends more than the gateway can
    look at loses texts, reports, parameters and reached items before they are events: of them there is no event, only
    `gateway_occurrences_total{name="vehicle.ID.inbox_dropped"}`.
    """
  end

  defp event(%{type: type, when: moment, source: source, fields: fields} = event) do
    rows =
      for field <- fields, do: row(["`#{field.name}`", Atom.to_string(field.type), field.unit, field.meaning])

    table = if rows == [], do: "", else: ["\n", header(~w(field type unit meaning)), rows]
    ["\n### #{type}\n\n", sentence(moment), " Shown by: ", source, ".", alarm(event), "\n", table]
  end

  defp alarm(%{begins: nil}), do: ""

  defp alarm(%{begins: {kind, severity, text}, over: over} = event) do
    [ends] = for %{ends: ^kind, type: type} <- Event.Types.all(), do: type
    mend = if event.mend, do: " What to do: #{event.mend}", else: ""

    " Alarm: #{text} (#{severity}), until `#{ends}`, or until the state shows that it is over: #{over}.#{mend}"
  end

  defp sentence(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest <> "."

  defp header(names), do: [row(names), "|", List.duplicate("---|", length(names)), "\n"]
  defp row(cells), do: ["|", Enum.map(cells, &[" ", escape(&1 || ""), " |"]), "\n"]
  defp escape(text), do: String.replace(text, "|", "\\|")
end
