defmodule Aerie.Fleet.Replay.LiveTest do
  @moduledoc """
  A live gateway that plays a recording (`replay:FILE`), and the pure replay of the same one: the very same events, ids
  included.
  """
  use ExUnit.Case, async: true
  use Aerie.GatewayCase

  alias Aerie.Base.PubSub
  alias Aerie.Fleet.Replay
  alias MavRouter.Link

  @moduletag :tmp_dir
  @fixtures Path.expand("../../../../../vehicle/test/fixtures", __DIR__)

  for recording <- ~w(arducopter_flight px4_refusals) do
    test "#{recording}", %{tmp_dir: dir} do
      path = Path.join(dir, "flight.tlog")

      File.write!(
        path,
        @fixtures |> Path.join(unquote(recording) <> ".tlog.gz") |> File.read!() |> :zlib.gunzip()
      )

      {:ok, flight} = Replay.run(path)
      gateway = start_gateway(%{}, with: [:router, :links])
      :ok = PubSub.subscribe(gateway, :events)
      {:ok, _id} = Link.start(gateway, "replay:#{path}?speed=max", id: "replay", network: "main")
      assert live(length(flight.events)) == flight.events
    end
  end

  defp live(0), do: []

  defp live(n) do
    receive do
      {:fleet, :events, event} -> [event | live(n - 1)]
    after
      Aerie.Patience.ms() -> flunk("#{n} events more were expected")
    end
  end
end
