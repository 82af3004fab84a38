defmodule Aerie.Incident.Page do
  @moduledoc """
  The page of an incident: one file without anything from a network. Its texts and tables are there without a script; its plots are drawn by
  uPlot, which stands in the page with the recorded values. A policy in the page lets no other script run. Pure.
  """

  alias Aerie.Base.{Json, Printable}
  alias Aerie.Incident.{Flight, Span, Timeline}

  @external_resource Path.join(__DIR__, "page.css")
  @external_resource Path.join(__DIR__, "page.js")
  @css File.read!(Path.join(__DIR__, "page.css"))
  @js File.read!(Path.join(__DIR__, "page.js"))
  # State that does not change is published every 30 s; a longer gap is a gap.
  @gap_s 35
  @colours 6
  @longest 600
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
  - `plotter`: uPlot's script and style, nil if it is not installed
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
          files: [{String.t(), non_neg_integer(), String.t()}],
          plotter: {script :: String.t(), style :: String.t()} | nil
        }

  @doc "The page as HTML."
  @spec render(content()) :: iodata()
  def render(content) do
    %{vehicle: vehicle, span: span} = content
    {scripts, style} = scripts(content.plotter)
    hashes = for script <- scripts, do: " 'sha256-#{Base.encode64(:crypto.hash(:sha256, script))}'"
    drawings = drawings(content)

    [
      ~s(<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8">\n),
      ~s(<meta http-equiv="Content-Security-Policy" content="default-src 'none'; style-src 'unsafe-inline'; ),
      ["script-src", if(hashes == [], do: " 'none'", else: hashes), ~s(">\n)],
      ~s(<meta name="viewport" content="width=device-width"><title>#{text(vehicle)}, #{Span.text(span.from)}</title>\n),
      ["<style>\n", style, @css, "</style></head>\n<body>\n"],
      "<h1>#{text(vehicle)}</h1>\n",
      "<p>#{Span.text(span.from)} to #{Span.text(span.to)}, #{length_of(span)}. All times are UTC.</p>\n",
      notes(content.notes),
      "<h2>Flight</h2>\n",
      plots(content.plotter, drawings),
      "<h2>What happened</h2>\n",
      table(content),
      conditions(content.conditions),
      shadow(content.shadow),
      files(content),
      data(span, drawings),
      for(script <- scripts, do: ["<script>", script, "</script>\n"]),
      "</body></html>\n"
    ]
  end

  defp scripts(nil), do: {[], ""}
  defp scripts({script, style}), do: {[script, @js], style}

  defp length_of(span) do
    seconds = div(span.to - span.from, 1_000_000)
    {hours, minutes} = {div(seconds, 3_600), seconds |> rem(3_600) |> div(60)}
    parts = [{hours, "h"}, {minutes, "min"}, {rem(seconds, 60), "s"}]
    Enum.map_join(Enum.reject(parts, &(elem(&1, 0) == 0)), " ", fn {n, unit} -> "#{n} #{unit}" end)
  end

  defp notes([]), do: []

  defp notes(notes),
    do: ["<h2>Not in this archive</h2>\n<ul>", for(note <- notes, do: "<li>#{text(note)}</li>"), "</ul>\n"]

  # What is drawn, in order: kind, title, and points of its kind (`page.js`).
  defp drawings(%{flight: flight, span: span, rows: rows}) do
    last = max(flight.last || span.from, span.from)

    curves =
      for {name, title, unit} <- Flight.plots(),
          points = for({at, value} <- flight.series[name] || [], do: [seconds(at), round_to(value, 3)]),
          # It only stands in for the height above home.
          not (name == :altitude_msl and points == []),
          do: {"curve", "#{title}, #{unit}", points}

    [
      {"marks", "Marks", for(row <- rows, do: [row.n, seconds(row.at), row.kind, mark(row)])},
      {"band", "Mode", bands(flight.changes.mode, last, modes(flight.changes.mode))},
      {"band", "Armed", bands(flight.changes.armed, last, &armed/1)}
    ] ++
      curves ++
      [{"track", "Ground track", for({lat, lon} <- flight.track, do: [round_to(lat, 7), round_to(lon, 7)])}]
  end

  defp mark(row), do: line("#{tenths(row.at)} #{row.what} #{row.decision} #{row.result}")

  # Each value holds until the next one; the last one until it was heard last.
  defp bands(changes, last, show) do
    ends = changes |> Enum.drop(1) |> Enum.map(&elem(&1, 0)) |> Enum.concat([last])

    for {{from, value}, to} <- Enum.zip(changes, ends), {text, class} = show.(value) do
      [seconds(from), seconds(to), line(text), class]
    end
  end

  defp plots(nil, _drawings) do
    ~s(<p class="quiet">There are no plots: uPlot is not installed here \(bin/setup --tests installs it\). ) <>
      "The recordings are in the archive.</p>\n"
  end

  defp plots(_plotter, drawings) do
    [
      ~s(<p class="quiet">Marks:),
      for({kind, name} <- @kinds, do: ~s(<span class="key #{kind}"></span>#{name})),
      "</p>\n<noscript><p>The plots need a browser that runs scripts.</p></noscript>\n",
      for {{kind, title, points}, n} <- Enum.with_index(drawings) do
        if points == [],
          do: ~s(<h3>#{text(title)}</h3><p class="quiet">Nothing was recorded of it.</p>\n),
          else: ~s(<h3>#{text(title)}</h3><div id="d#{n}" class="#{kind}"></div>\n)
      end
    ]
  end

  # Inside a script element no `<` may begin a tag.
  defp data(span, drawings) do
    drawings =
      for {kind, title, points} <- drawings, do: %{"kind" => kind, "title" => title, "points" => points}

    gap = max(@gap_s, div(span.to - span.from, 150_000_000))
    data = %{"from" => seconds(span.from), "to" => seconds(span.to), "gap" => gap, "drawings" => drawings}
    json = data |> Json.encode!() |> String.replace("<", "\\u003c")
    [~s(<script type="application/json" id="data">), json, "</script>\n"]
  end

  defp seconds(us), do: us / 1_000_000
  defp round_to(value, decimals), do: Float.round(value / 1, decimals)

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
      for %{"severity" => severity, "subject" => subject, "id" => id, "title" => title} <- conditions do
        "<li>#{text("#{severity}")}: #{text("#{subject}")} #{text(id)}: #{text(title)}</li>\n"
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

  # Names and status texts come from outside: every text of the page goes through `text/1` or `line/1`.
  defp text(text) do
    text
    |> line()
    |> String.replace("&", "&amp;")
    |> String.replace("<", "&lt;")
    |> String.replace(">", "&gt;")
    |> String.replace("\"", "&quot;")
    |> String.replace("'", "&#39;")
  end

  # On one line, without characters that are not seen, and cut if it is very long.
  defp line(nil), do: ""

  defp line(text) when is_binary(text) do
    text = Printable.line(text)
    if String.length(text) > @longest, do: String.slice(text, 0, @longest) <> " …", else: text
  end

  defp line(other), do: other |> to_string() |> line()

  # The time of day of unix microseconds, in UTC.
  defp tenths(us) do
    clock = us |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")
    "#{clock}.#{us |> Integer.mod(1_000_000) |> div(100_000)}"
  end
end
