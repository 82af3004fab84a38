defmodule Aerie.MapPage do
  @moduledoc "The map's page in a browser, and vehicles that fly on it."

  import Aerie.ConsoleCase

  alias ExUnit.Callbacks

  @doc "Does a task of `map.mjs`. Screenshots, for a look: `AERIE_SHOTS=FOLDER`."
  @spec browse_map(Aerie.ConsoleCase.t(), String.t(), [String.t()], atom()) :: String.t()
  def browse_map(console, task, more \\ [], who \\ :operator) do
    shots = List.wrap(System.get_env("AERIE_SHOTS"))

    browse(
      console,
      "map.mjs",
      ["#{who}", password(who), task] ++ if(more == [], do: ["-"], else: more) ++ shots
    )
  end

  @doc "A vehicle that flies a circle, 5 times a second, until the test ends."
  @spec fly(Aerie.ConsoleCase.t(), pos_integer(), float(), float()) :: pid()
  def fly(console, n, lat, lon \\ 8.5456) do
    Callbacks.start_supervised!(
      {Task,
       fn ->
         for step <- Stream.iterate(n, &(&1 + 1)) do
           angle = step / 10
           position = %{lat: lat + 0.0004 * :math.sin(angle), lon: lon + 0.0006 * :math.cos(angle)}

           position =
             Map.merge(position, %{heading: rem(round(-angle * 57.3), 360) + 360.0, alt_rel: 20.0 + n})

           velocity = %{
             vn: 4.0 * :math.cos(angle),
             ve: -4.0 * :math.sin(angle),
             groundspeed: 4.0 + rem(step, 10) / 10
           }

           put_vehicle(console, "VID-#{n}", [position: position, velocity: velocity], %{
             key: {"main", n},
             system_id: n
           })

           Process.sleep(200)
         end
       end},
      id: {:fly, n}
    )
  end
end
