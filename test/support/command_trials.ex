defmodule Aerie.CommandTrials do
  @moduledoc """
  Every command of the table (`Aerie.Vehicle.Command.Types`), as it is tried on the simulated vehicles by Aerie itself, by pymavlink and by
  MAVSDK, and what each answers. The rows are one flight, in this order; `test/system/command_trials_test.exs` flies it,
  and a table of `docs/commands.md` is made from it.
  """

  alias Aerie.Vehicle.Command.Page
  alias Aerie.CommandTrials.{Flying, Row, Standing}

  @page Path.expand("../../docs/commands.md", __DIR__)
  @lat -35.363261
  @lon 149.165230
  @msl 584.0

  @doc "The plan that the vehicle has aboard, in MAVLink's waypoints format."
  @spec plan() :: String.t()
  def plan do
    items = [{0, 16, 0, @msl}, {3, 22, 0, 12}, {3, 16, 0.0005, 15}, {3, 16, 0.001, 15}, {3, 21, 0.001, 0}]

    lines =
      for {{frame, command, north, z}, n} <- Enum.with_index(items),
          do: Enum.join([n, 0, frame, command, 0, 0, 0, 0, @lat + north, @lon, z, 1], "\t")

    Enum.join(["QGC WPL 110" | lines], "\n") <> "\n"
  end

  @doc "The flight of a vehicle with a firmware."
  @spec rows(:ardupilot | :px4) :: [Row.t()]
  def rows(firmware) do
    by = fn ardupilot, px4 -> if firmware == :ardupilot, do: ardupilot, else: px4 end
    Standing.rows(by) ++ Flying.rows(by)
  end

  @doc "What `docs/commands.md` says of the trials."
  @spec page() :: String.t()
  def page, do: Page.renew(File.read!(@page), %{"trials" => table()})

  @doc "Renews that table: `MIX_ENV=test mix run --no-start -e 'Aerie.CommandTrials.write()'` in `apps/aerie`."
  @spec write() :: :ok
  def write, do: File.write!(@page, page())

  # A command that is tried several times has one row.
  defp table do
    [ardupilot, px4] = for firmware <- [:ardupilot, :px4], do: firmware |> rows() |> Enum.uniq_by(& &1.type)

    Page.table(
      [
        "command",
        "of MAVSDK",
        "ArduPilot: Aerie",
        "pymavlink",
        "MAVSDK",
        "PX4: Aerie",
        "pymavlink",
        "MAVSDK"
      ],
      for(
        {row, other} <- Enum.zip(ardupilot, px4),
        do: ["`#{row.type}`", Row.method(row)] ++ answers(row) ++ answers(other)
      )
    )
  end

  defp answers(row), do: ["`#{row.own}`", Row.acknowledgement(row), Row.result(row)]
end
