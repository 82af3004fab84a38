defmodule Aerie.Incident.BrowserTest do
  @moduledoc "The page of an incident in a browser, with uPlot as the archive has it."
  use ExUnit.Case, async: true

  alias Aerie.Browser
  alias Aerie.Incident.{Flight, Page, Span}
  alias Aerie.Console.Assets

  @moduletag :tmp_dir
  @script Path.expand("../../../../../test/browser/incident.mjs", __DIR__)
  @span %Span{from: 1_795_900_000_000_000, to: 1_795_900_900_000_000}

  @tag :chromium
  test "curves, modes, marks and the track are drawn, and dragging zooms all of them", %{tmp_dir: dir} do
    {:ok, script} = Assets.read("npm/uplot/uPlot.iife.min.js")
    {:ok, style} = Assets.read("npm/uplot/uPlot.min.css")
    at = &(@span.from + &1 * 1_000_000)

    flight = %{
      Flight.none("VID-007", @span)
      | series: %{
          altitude: for(n <- Enum.concat(0..300, 600..900), do: {at.(n), rem(n, 50)}),
          speed: [{at.(9), 5}]
        },
        changes: %{mode: [{at.(0), "LOITER"}, {at.(450), "RTL"}], armed: [{at.(0), true}]},
        track: for(n <- 0..99, do: {47 + n / 10_000, 8 + n / 20_000}),
        last: @span.to
    }

    row = &%{n: &1, at: at.(&2), kind: &3, what: "what", who: "", decision: "", result: ""}
    rows = [row.(1, 60, :event), row.(2, 300, :refused), row.(3, 800, :note)]

    html =
      Page.render(%{
        vehicle: "VID-007",
        span: @span,
        version: "0.1.0",
        flight: flight,
        rows: rows,
        more: 0,
        conditions: [],
        shadow: nil,
        notes: [],
        files: [],
        plotter: {script, style}
      })

    file = Path.join(dir, "index.html")
    File.write!(file, html)
    {output, status} = Browser.run(@script, [file])
    assert status == 0, output
    assert %{"complaints" => [], "drawn" => [height, speed, track]} = seen = JSON.decode!(output)
    assert height > speed and speed > 0 and track > 0

    # From a quarter to the half of the time: the first mode is all of it, and of the marks only the refusal is there.
    assert %{"whole" => %{"band" => half, "marks" => 3}, "zoomed" => %{"band" => wider, "marks" => 1}} = seen
    assert_in_delta wider / half, 4, 0.2
    assert_in_delta seen["again"]["band"], half, 1
    assert seen["again"]["marks"] == 3
  end
end
