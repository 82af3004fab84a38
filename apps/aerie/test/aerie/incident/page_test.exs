defmodule Aerie.Incident.PageTest do
  use ExUnit.Case, async: true

  alias Aerie.Incident.{Flight, Page, Span, Timeline}
  alias Aerie.Vehicle.Event

  @span %Span{from: 1_795_900_000_000_000, to: 1_795_900_900_000_000}
  @hostile "</script><script>alert(1)</script>'\"&<img src=x onerror=alert(2)>\u202Eevil\u0000\x07" <>
             <<0xFF, 0xFE>>

  defp content(more) do
    Map.merge(
      %{
        vehicle: "VID-007",
        span: @span,
        version: "0.1.0",
        flight: Flight.none("VID-007", @span),
        rows: [],
        more: 0,
        conditions: nil,
        shadow: nil,
        notes: [],
        files: [],
        plotter: {"var uPlot = 1;", ".uplot{}"}
      },
      more
    )
  end

  defp page(more \\ %{}), do: more |> content() |> Page.render() |> IO.iodata_to_binary()

  defp row(at, kind, what),
    do: %{n: 1, at: at, kind: kind, what: what, who: what, decision: what, result: what}

  # As a browser does: every tag is closed in order.
  defp well_formed(html) do
    [_head, rest] = String.split(html, "</head>", parts: 2)
    [rest, _scripts] = String.split(rest, "<script", parts: 2)

    stack =
      ~r{<(/?)([a-z0-9]+)[^<>]*?(/?)>}
      |> Regex.scan(rest)
      |> Enum.reduce([], fn
        [_all, "", tag, ""], stack -> [tag | stack]
        [_all, "", _tag, "/"], stack -> stack
        [_all, "/", tag, _], [tag | stack] -> stack
        [all, _slash, _tag, _], stack -> flunk("#{all} in #{inspect(stack)}")
      end)

    assert stack == ["body"]
  end

  # What the script draws, by its title.
  defp drawings(html) do
    [_all, json] = Regex.run(~r/<script type="application\/json" id="data">([^<]*)<\/script>/, html)
    for drawing <- JSON.decode!(json)["drawings"], into: %{}, do: {drawing["title"], drawing["points"]}
  end

  test "without any data it says so, and is a whole page" do
    html = page()
    assert html =~ "Nothing was recorded of it" and html =~ "No event, no command"
    assert html =~ "15 min" and html =~ "VID-007"
    assert Enum.all?(drawings(html), fn {_title, points} -> points == [] end)
    well_formed(html)
  end

  test "hostile text is text: in names, rows, notes, modes, conditions, files and the desired state" do
    flight = %{
      Flight.none(@hostile, @span)
      | changes: %{mode: [{@span.from, @hostile}, {@span.from + 600_000_000, "x"}], armed: []},
        last: @span.to
    }

    html =
      page(%{
        vehicle: @hostile,
        version: @hostile,
        flight: flight,
        rows: for(kind <- [:event, :alarm, :command, :refused, :note], do: row(@span.from, kind, @hostile)),
        conditions: [%{"severity" => @hostile, "subject" => @hostile, "id" => @hostile, "title" => @hostile}],
        shadow: %{"desired" => %{(@hostile |> String.replace_invalid()) => "</code><script>"}},
        notes: [@hostile],
        files: [{@hostile, 1, @hostile}]
      })

    assert String.valid?(html)
    assert [_data, _plotter, _ours] = Regex.scan(~r/<script/i, html)
    assert %{"Mode" => [[_from, _to, mode, "m0"], _x]} = drawings(html)
    assert mode =~ "</script><script>alert(1)"
    refute html =~ "<img" or html =~ "\u202E" or html =~ <<0>>
    assert html =~ "&lt;script&gt;alert(1)&lt;/script&gt;&#39;&quot;&amp;&lt;img"
  end

  test "the policy in the page is the hashes of its two scripts, and nothing comes from elsewhere" do
    html = page()

    assert [script, _own] =
             scripts = for([_all, script] <- Regex.scan(~r/<script>(.*?)<\/script>/s, html), do: script)

    assert script == "var uPlot = 1;"
    hashes = Enum.map_join(scripts, " ", &"'sha256-#{Base.encode64(:crypto.hash(:sha256, &1))}'")
    assert html =~ "default-src 'none'; style-src 'unsafe-inline'; script-src #{hashes}\""
    refute html =~ ~r/src=|@import|url\(|https?:/
  end

  test "without uPlot it says why there are no plots, and runs no script" do
    html = page(%{plotter: nil, rows: [row(@span.from, :event, "armed")]})
    assert html =~ "uPlot is not installed" and html =~ "script-src 'none'" and html =~ ~s(id="r1")
    refute html =~ "<script>"
  end

  test "one sample is a point, and its page is whole" do
    flight = %{
      Flight.none("VID-007", @span)
      | series: %{altitude: [{@span.from + 1_000_000, 12.5}]},
        last: @span.to
    }

    html =
      page(%{
        flight: %{
          flight
          | track: [{47.0, 8.0}],
            changes: %{mode: [{@span.from, nil}], armed: [{@span.from, true}]}
        }
      })

    [from, to] = [@span.from / 1_000_000, @span.to / 1_000_000]

    assert %{
             "Altitude above home, m" => [[at, 12.5]],
             "Mode" => [[^from, ^to, "unknown", "none"]],
             "Armed" => [[^from, ^to, "armed", "on"]],
             "Ground track" => [[47.0, 8.0]],
             "Marks" => []
           } = drawings(html)

    assert at == from + 1
    well_formed(html)
  end

  test "rows: events of a replay hide the gateway's own of the same moment, refused commands are marked, no more than 2000" do
    event = fn type, at, data -> Event.new("VID-007", type, 1, at, nil, data) end
    at = @span.from + 5_000_000
    replayed = [event.("armed", at, %{"mode" => "AUTO"})]
    live = [event.("armed", at + 300_000, %{}), event.("gcs.lost", at + 1, %{})]

    commands = [
      %{
        "type" => "goto",
        "decision" => "deny",
        "rule" => "altitude",
        "reason" => "too high",
        "result" => "denied",
        "decided_at" => at + 9
      }
    ]

    audit = [
      %{at: at + 10, line: "", fields: %{"type" => "policy", "loaded" => true, "source" => "ann"}},
      %{at: at + 11, line: "", fields: %{"type" => "result"}}
    ]

    assert {[armed, lost, goto, policy], 0} = Timeline.rows(replayed, live, commands, audit, @span)
    assert armed.what =~ "armed mode=AUTO" and lost.what == "gcs.lost"
    assert %{kind: :refused, decision: "deny rule altitude too high", n: 3} = goto
    assert %{kind: :note, who: "ann"} = policy

    many = for n <- 1..2_100, do: event.("armed", @span.from + n, %{})
    assert {rows, 100} = Timeline.rows(many, [], [], [], @span)
    assert length(rows) == 2_000
    html = page(%{rows: rows, more: 100})
    assert html =~ "100 further rows"
    assert length(drawings(html)["Marks"]) == 2_000

    # A refusal is in the table, whenever it came.
    refused = [%{hd(commands) | "decided_at" => @span.from + 5_000}]
    assert {rows, 101} = Timeline.rows(many, [], refused, [], @span)
    assert List.last(rows).kind == :refused
  end
end
