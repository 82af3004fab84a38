defmodule Aerie.Vehicle.Fields.Page do
  @moduledoc """
  `docs/telemetry.md`, made from `Aerie.Vehicle.Fields` and `Aerie.Vehicle.EventTypes` (`mix aerie.telemetry`), so that what is
  published and what is written about it are one.
  """

  alias Aerie.Vehicle.{EventTypes, Fields}
  alias Aerie.Vehicle.Fields.Object

  @doc "The text of the page."
  @spec markdown() :: String.t()
  def markdown do
    [
      intro(),
      "\n## State\n\n",
      state(),
      for({group, title, fields} <- Fields.all(), do: group(group, title, fields)),
      "\n## A vehicle\n\nThe object of `state.sock` and `/api/status`:\n\n",
      object(Object.short()),
      "\n`GET /api/vehicles/ID` has these besides:\n\n",
      object(Object.long()),
      "\n## A link\n\nThe objects of `GET /api/links`:\n\n",
      object(Object.link()),
      "\n## Events\n\n",
      events(),
      for(type <- EventTypes.all(), do: event(type))
    ]
    |> IO.iodata_to_binary()
  end

  defp intro do
    """
    # Telemetry: every field, its unit, its meaning

    <!-- Made by `mix aerie.telemetry` from Aerie.Vehicle.Fields and Aerie.Vehicle.EventTypes: change those, not this page. -->

    NATS, REST and `state.sock` use one vocabulary: a field has the same name, unit and number of decimals in all of them.

    - Units are SI, with degrees for angles and places. A share is 0..1, never per cent. A height says above what.
    - null is "not known"; a value that is not told any more stays and has an age.
    - `time` is ISO 8601 in UTC with milliseconds, by the gateway's clock; `time_boot_ms` the vehicle's own clock, milliseconds
      since its boot; `timestamp` unix time in seconds, of the answer itself; `age` seconds.
    - `epoch` is the number of the gateway's life, greater with each start: another one means that it was started anew. An event's
      `seq` begins at 1 in each epoch.
    - Numbers are rounded to the decimals that mean something when they are told, not before.

    | where | what |
    |---|---|
    | NATS `fleet.{environment}.{vehicle}.state.{group}` | `vehicle`, `group`, `epoch`, `time`, `time_boot_ms`, `data`: a group below |
    | NATS `fleet.{environment}.{vehicle}.event.{type}` | `id`, `vehicle`, `type`, `epoch`, `seq`, `time`, `time_boot_ms`, `data`: an event below |
    | `GET /api/vehicles/ID` | `groups`: each with `time`, `age`, `time_boot_ms`, `data`; and the vehicle itself |
    | `GET /api/vehicles/ID/events`, `GET /api/events` | the latest events, each as in NATS |
    | `GET /api/links` | a link below |
    | `state.sock`, `GET /api/status` | of some groups the fields that most want, with `ages` |

    How often a group is published is said by `sampling` in the configuration. A group with the strategy `aggregate` has, beside
    its means, `min` and `max` of each number and how many `samples` they are of.
    """
  end

  defp state,
    do: "Sources are MAVLink messages; of several that tell the same the better one wins while it comes.\n"

  defp group(group, title, fields) do
    rows =
      for field <- fields do
        name = Enum.map_join(field.path, ".", &Atom.to_string/1)
        row(["`#{name}`", field.unit, decimals(field), field.meaning, field.source])
      end

    ["\n### #{group}\n\n", title, "\n\n", header(~w(field unit decimals meaning source)), rows]
  end

  defp object(fields),
    do: [header(~w(field unit meaning)), for(f <- fields, do: row(["`#{f.name}`", f.unit, f.meaning]))]

  defp decimals(%{decimals: nil}), do: nil
  defp decimals(%{decimals: n}), do: Integer.to_string(n)

  defp events do
    """
    At least once, in the order of `seq`, with an `id` that is the same for the same event however often it comes. `time` is when
    the gateway received what shows it. `position` (`lat`, `lon`, `alt_msl`, `alt_rel` as above) may be in the data of each type
    that the vehicle's state shows: where it was then.
    """
  end

  defp event(%{type: type, when: moment, source: source, fields: fields}) do
    rows =
      for field <- fields, do: row(["`#{field.name}`", Atom.to_string(field.type), field.unit, field.meaning])

    table = if rows == [], do: "", else: ["\n", header(~w(field type unit meaning)), rows]
    ["\n### #{type}\n\n", sentence(moment), " Shown by: ", source, ".\n", table]
  end

  defp sentence(<<first::utf8, rest::binary>>), do: String.upcase(<<first::utf8>>) <> rest <> "."

  defp header(names), do: [row(names), "|", List.duplicate("---|", length(names)), "\n"]
  defp row(cells), do: ["|", Enum.map(cells, &[" ", escape(&1 || ""), " |"]), "\n"]
  defp escape(text), do: String.replace(text, "|", "\\|")
end
