defmodule Aerie.Incident.Page do
  @moduledoc """
  The page of an incident: one file without anything from a network, drawn here, so that it can be read without a script and printed. Its one
  script moves a cursor. A policy in the page lets no other script run. Pure.
  """

  import Aerie.Incident.Html

  alias Aerie.Incident.{Flight, Plot, Span, Timeline, Track}

  @external_resource Path.join(__DIR__, "page.css")
  @external_resource Path.join(__DIR__, "page.js")
  @css File.read!(Path.join(__DIR__, "page.css"))
  @js File.read!(Path.join(__DIR__, "page.js"))
  @js_hash Base.encode64(:crypto.hash(:sha256, @js))
  @colours 6
  @kinds [
    event: "event",
    alarm: "alarm",
    command: "command",
    refused: "refused command",
    note: "audit log"
  ]

  @typedoc """
  - `flight`: `Aerie.Incident.Flight`; `rows` and `more` of `Aerie.Incident.Timeline`
  - `conditions`: of the diagnosis, with text keys; `shadow`: as in `shadow.json`, nil if it is not known
  - `notes`: what could not be had; `files`: `{name, bytes, what it is}`
  """
  @type content :: %{
          vehicle: String.t(),
          span: Span.t(),
          version: String.t(),
          flight: Flight.t(),
          rows: [Timeline.row()],
          more: non_neg_integer(),
          conditions: [map()] | nil,
          shadow: map() | nil,
          notes: [String.t()],
          files: [{String.t(), non_neg_integer(), String.t()}]
        }

  @doc "The page as HTML."
  @spec render(content()) :: iodata()
  def render(content) do
    %{vehicle: vehicle, span: span} = content
    {width, left, inner} = Plot.measures()

    [
      ~s(<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n),
      ~s(<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; script-src 'sha256-#{@js_hash}'">\n),
      ~s(<meta name="viewport" content="width=device-width"><title>#{text(vehicle)}, #{Span.text(span.from)}</title>\n),
      ["<style>\n", @css, "</style></head>\n"],
      ~s(<body data-from="#{div(span.from, 1000)}" data-to="#{div(span.to, 1000)}" data-width="#{width}" data-left="#{left}" data-inner="#{inner}">\n),
      "<h1>#{text(vehicle)}</h1>\n<p>#{Span.text(span.from)} to #{Span.text(span.to)}, #{length_of(span)}. All times are UTC.</p>\n",
      notes(content.notes),
      "<h2>Flight</h2>\n",
      plots(content),
      "<h2>What happened</h2>\n",
      table(content),
      conditions(content.conditions),
      shadow(content.shadow),
      files(content),
      ~s(<div id="at"></div>\n<script>),
      @js,
      "</script>\n</body></html>\n"
    ]
  end

  defp length_of(span) do
    seconds = div(span.to - span.from, 1_000_000)
    {hours, minutes} = {div(seconds, 3_600), seconds |> rem(3_600) |> div(60)}
    parts = [{hours, "h"}, {minutes, "min"}, {rem(seconds, 60), "s"}]
    Enum.map_join(Enum.reject(parts, &(elem(&1, 0) == 0)), " ", fn {n, unit} -> "#{n} #{unit}" end)
  end

  defp notes([]), do: []

  defp notes(notes),
    do: ["<h2>Not in this archive</h2>\n<ul>", for(note <- notes, do: "<li>#{text(note)}</li>"), "</ul>\n"]

  defp plots(%{flight: flight, span: span, rows: rows}) do
    last = flight.last || span.from

    drawn = [
      band(flight.changes.mode, "Mode", span, last, modes(flight.changes.mode)),
      band(flight.changes.armed, "Armed", span, last, &armed/1),
      for(
        {name, title, unit} <- Flight.plots(),
        do: curve(flight.series[name], name, "#{title}, #{unit}", span, rows)
      )
    ]

    [
      [
        "<p class=\"quiet\">Marks:",
        for({kind, name} <- @kinds, do: ~s(<span class="key #{kind}"></span>#{name})),
        "</p>\n"
      ],
      Plot.lane(rows, "What happened", span),
      drawn,
      track(flight.track)
    ]
  end

  defp band([], title, _span, _last, _show), do: missing(title)

  defp band(changes, title, span, last, show),
    do: [heading(title), Plot.bands(changes, title, span, last, show), "\n"]

  # It only stands in for the height above home.
  defp curve(points, :altitude_msl, _title, _span, _rows) when points in [nil, []], do: []
  defp curve(points, _name, title, _span, _rows) when points in [nil, []], do: missing(title)

  defp curve(points, _name, title, span, rows),
    do: [heading(title), Plot.curve(points, title, span, rows), "\n"]

  defp track([]), do: missing("Ground track")
  defp track(places), do: [heading("Ground track"), Track.svg(places), "\n"]

  defp heading(title), do: "<h3>#{text(title)}</h3>\n"
  defp missing(title), do: ~s(<h3>#{text(title)}</h3><p class="quiet">Nothing was recorded of it.</p>\n)

  defp modes(changes) do
    colours = changes |> Enum.map(&elem(&1, 1)) |> Enum.uniq() |> Enum.with_index() |> Map.new()
    fn mode -> {mode || "unknown", if(mode, do: "m#{rem(colours[mode], @colours)}", else: "none")} end
  end

  defp armed(true), do: {"armed", "on"}
  defp armed(false), do: {"disarmed", "off"}
  defp armed(_unknown), do: {"unknown", "none"}

  defp table(%{rows: []}), do: "<p class=\"quiet\">No event, no command and no record of the audit log.</p>\n"

  defp table(%{rows: rows, more: more}) do
    [
      ~s(<table><thead><tr><th class="c1">Time</th><th>What</th><th class="c3">Who asked</th><th class="c4">Decision</th>),
      ~s(<th class="c5">Result</th></tr></thead><tbody>\n),
      for row <- rows do
        ~s(<tr id="r#{row.n}"><td>#{tenths(row.at)}</td><td class="#{row.kind}">#{text(row.what)}</td><td>#{text(row.who)}</td>) <>
          "<td>#{text(row.decision)}</td><td>#{text(row.result)}</td></tr>\n"
      end,
      "</tbody></table>\n",
      if(more > 0, do: "<p>#{more} further rows are in the files.</p>\n", else: [])
    ]
  end

  defp conditions(nil), do: []

  defp conditions(conditions) do
    [
      "<h2>Diagnosis when this archive was made</h2>\n",
      if(conditions == [], do: "<p class=\"quiet\">Nothing was wrong.</p>\n", else: "<ul>"),
      for condition <- conditions do
        "<li>#{text(condition["severity"])}: #{text(condition["subject"])} #{text(condition["id"])}: #{text(condition["title"])}</li>\n"
      end,
      if(conditions == [], do: [], else: "</ul>\n")
    ]
  end

  defp shadow(nil), do: []

  defp shadow(shadow) do
    [
      "<h2>Desired state when this archive was made</h2>\n<p><code>",
      text(JSON.encode!(shadow["desired"] || %{})),
      "</code></p>\n"
    ]
  end

  defp files(content) do
    [
      "<h2>Files</h2>\n<table><tbody>\n",
      for(
        {name, bytes, what} <- content.files,
        do:
          ~s(<tr><td class="f1">#{text(name)}</td><td class="f2">#{bytes} bytes</td><td>#{text(what)}</td></tr>\n)
      ),
      ~s(</tbody></table>\n<p class="quiet">Aerie #{text(content.version)}. <code>aerie replay flight.tlog</code> prints the events again.</p>\n)
    ]
  end
end
