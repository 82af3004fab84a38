defmodule Aerie.Incident.PageTest do
  use ExUnit.Case, async: true

  alias Aerie.Incident.{Flight, Page, Plot, Span, Timeline, Track}
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
        files: []
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
    [rest, _script] = String.split(rest, "<script>", parts: 2)

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

  test "without any data it says so, and is a whole page" do
    html = page()
    assert html =~ "Nothing was recorded of it" and html =~ "No event, no command"
    assert html =~ "15 min" and html =~ "VID-007"
    refute html =~ "Infinity" or html =~ "nan"
    assert [_once] = Regex.scan(~r/<script/, html)
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
    assert [_ours] = Regex.scan(~r/<script/i, html)
    refute html =~ "<img" or html =~ "\u202E" or html =~ <<0>>
    assert html =~ "&lt;script&gt;alert(1)&lt;/script&gt;&#39;&quot;&amp;&lt;img"
  end

  test "the policy in the page is the hash of its one script, and nothing comes from elsewhere" do
    html = page()
    [_all, script] = Regex.run(~r/<script>(.*)<\/script>/s, html)
    assert html =~ "script-src 'sha256-#{Base.encode64(:crypto.hash(:sha256, script))}'"
    assert html =~ "default-src 'none'"
    refute html =~ ~r/src=|@import|url\(|https?:/
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

    assert html =~ "Altitude above home, m" and html =~ "<circle"
    assert html =~ "armed" and html =~ "unknown" and html =~ "Ground track"
    well_formed(html)
  end

  test "gaps interrupt a curve, and equal values have a scale" do
    points = for second <- Enum.concat(0..100, 300..400), do: {@span.from + second * 1_000_000, 5}
    svg = points |> Plot.curve("t", @span, []) |> IO.iodata_to_binary()
    assert [_one, _two] = Regex.scan(~r/<polyline/, svg)
    assert {low, high, [_ | _]} = Plot.scale({5, 5})
    assert low <= 5 and high >= 5 and low < high

    for pair <- [{0, 0}, {-3.2, 900.0}, {1.0e9, 1.0e9 + 1}, {-1.0e-9, 1.0e-9}, {0.001, 0.002}] do
      assert {low, high, ticks} = Plot.scale(pair)
      assert low <= elem(pair, 0) and high >= elem(pair, 1)
      assert length(ticks) in 2..7
    end
  end

  test "a track of one place, one of the whole earth and one across the date line are drawings" do
    for places <- [[{47.0, 8.0}], [{-90, -180}, {90, 180}], [{0, 179.999}, {0, -179.999}]] do
      svg = places |> Track.svg() |> IO.iodata_to_binary()
      refute svg =~ ~r/nan|inf/i
    end

    # 222 m, not around the earth.
    assert [{0, 179.999}, {0, -179.999}] |> Track.svg() |> IO.iodata_to_binary() =~ "50 m"
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
    # Marks are over the whole time.
    marks = for [_all, n] <- Regex.scan(~r/href="#r(\d+)"/, html), do: String.to_integer(n)
    assert length(marks) in 200..450 and Enum.max(marks) > 1_950

    # A refusal is in the table, whenever it came.
    refused = [%{hd(commands) | "decided_at" => @span.from + 5_000}]
    assert {rows, 101} = Timeline.rows(many, [], refused, [], @span)
    assert List.last(rows).kind == :refused
  end
end
