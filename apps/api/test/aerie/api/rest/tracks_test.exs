defmodule Aerie.Api.Rest.TracksTest do
  @moduledoc "`GET /api/tracks`."
  use Aerie.APICase, async: true

  alias Aerie.Fleet.Tracks

  @moduletag :tmp_dir
  @at 1_699_999_200

  # Two vehicles that fly for some minutes.
  defp flown(gateway, dir, seconds) do
    {:ok, files, 0} = Tracks.Files.open(gateway, dir, max_bytes: 100_000_000, keep_ms: 86_400_000)
    Tracks.Metrics.status(gateway, %{dir: dir, bytes: 0, problem: nil})

    for second <- seconds, reduce: {files, Tracks.Core.new()} do
      {files, core} ->
        at = (@at + second) * 1000

        sample = %Tracks.Sample{
          lat: 480_000_000 + second,
          lon: 110_000_000,
          height: 105,
          flags: 3,
          battery: 80,
          mode: "AUTO"
        }

        tick = {:tick, at, [{"eagle", sample}, {"kite", %{sample | mode: nil, lat: nil}}]}
        {core, [{:write, ^at, begins?, block, 2}]} = Tracks.Core.handle(core, tick)
        {:ok, files, 0} = Tracks.Files.write(files, at, begins?, block)
        {files, core}
    end
  end

  test "the tracks of a span, page by page", %{tmp_dir: dir} do
    %{gateway: gateway, port: port} = start_server(key: true)
    flown(gateway, dir, 0..130)
    get = &request(port, "GET", "/api/tracks?" <> &1, [{"x-aerie-key", key()}])

    assert {200, _headers,
            %{"tracks" => [%{"vehicle" => "eagle", "samples" => [first, _]}], "next" => nil} = body} =
             get.("from=2023-11-14T22:00:00Z&to=#{@at + 1}&vehicles=eagle,nobody")

    assert first == %{
             "at" => "2023-11-14T22:00:00.000Z",
             "lat" => 48.0,
             "lon" => 11.0,
             "height" => 10.5,
             "heading" => nil,
             "speed" => nil,
             "age" => nil,
             "battery" => 0.8,
             "mode" => "AUTO",
             "armed" => true,
             "in_air" => true,
             "status" => "online"
           }

    assert body["since"] == first["at"]
    {200, _headers, %{"tracks" => tracks}} = get.("from=#{@at}&to=#{@at + 200}&step=60")

    assert for(%{"vehicle" => id, "samples" => samples} <- tracks, do: {id, length(samples)}) == [
             {"eagle", 3},
             {"kite", 3}
           ]

    # Without an end until now.
    assert {200, _headers, %{"tracks" => []}} = get.("from=#{@at + 131}")
  end

  test "an answer is bounded, and says where to go on", %{tmp_dir: dir} do
    %{gateway: gateway, port: port} = start_server(key: true)
    flown(gateway, dir, 0..5100)
    get = &request(port, "GET", "/api/tracks?from=#{&1}", [{"x-aerie-key", key()}])
    {200, _headers, %{"next" => next, "tracks" => [%{"samples" => samples} | _]}} = get.("#{@at}")
    assert length(samples) == 5000 and next == "2023-11-14T23:23:20.000Z"

    assert {200, _headers, %{"next" => nil, "tracks" => [%{"samples" => [%{"at" => ^next} | _] = rest} | _]}} =
             get.(next)

    assert length(rest) == 101
  end

  test "what is wrong with a request; a gateway that keeps none", %{tmp_dir: dir} do
    %{gateway: gateway, port: port} = start_server(key: true)
    get = &request(port, "GET", "/api/tracks" <> &1, [{"x-aerie-key", key()}])
    assert {503, _headers, %{"error" => %{"message" => text}}} = get.("?from=1")
    assert text =~ "keeps no tracks"
    flown(gateway, dir, [0])
    # The last hour, in which nothing flew.
    assert {200, _headers, %{"tracks" => []}} = get.("")

    for {query, words} <- [
          {"?from=yesterday", "from: expected a time"},
          {"?from=1&to=x", "to: expected a time"},
          {"?from=1&step=0", "step: expected an integer from 1 to 86400"},
          {"?from=1&vehicles=#{Enum.map_join(1..201, ",", &"v#{&1}")}", "vehicles: expected ids"},
          {"?from=1&vehicles=a,,b", "vehicles: expected ids"},
          {"?from=1&limit=7", "limit"}
        ] do
      assert {422, _headers, %{"error" => %{"message" => text}}} = get.(query)
      assert text =~ words
    end

    assert {401, _headers, _body} = request(port, "GET", "/api/tracks?from=1", [])
  end
end
