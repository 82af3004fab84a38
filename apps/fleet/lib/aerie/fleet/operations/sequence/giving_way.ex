defmodule Aerie.Fleet.Operations.Sequence.GivingWay do
  @moduledoc """
  An operation gives up a vehicle that somebody else, or its author by hand, has commanded to move since it began.

  | it does not count | because |
  |---|---|
  | a command of the operation itself, or of those that it was begun to abort | they may still be on their way |
  | what moves nothing | requests, parameters |
  | set-points that already came when it began | its author saw the vehicle so |
  | in an operation that ends flights: what does not end one | a program that goes on must not keep it from that |
  """

  alias Aerie.Base.Names
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Memory.RecentCommands
  alias Aerie.Vehicle.Command

  # A vehicle's commands have the numbers of its steps: with the waits before each `arm`, and its `else`.
  @numbers 0..31

  @typedoc "When an operation began (monotonic), whose commands are its own, and whether it ends flights."
  @type t :: %{since_us: integer(), ours: [operation :: String.t()], ends?: boolean()}

  @doc "The value for an operation that begins now."
  @spec new(ours :: [String.t()], ends? :: boolean()) :: t()
  def new(ours, ends?),
    do: %{since_us: System.monotonic_time(:microsecond), ours: ours, ends?: ends?}

  @doc "Why an operation leaves a vehicle alone; nil if it need not."
  @spec reason(Names.gateway(), vehicle :: String.t(), t()) :: String.t() | nil
  def reason(gateway, vehicle, way) do
    case RecentCommands.moved(gateway, vehicle) do
      [] -> nil
      moved -> reason(way, vehicle, moved, setpoints_since(gateway, vehicle))
    end
  end

  @doc "The same of what moved the vehicle, and since when set-points come (monotonic; nil if none come)."
  @spec reason(t(), String.t(), [RecentCommands.moved()], integer() | nil) :: String.t() | nil
  def reason(way, vehicle, moved, setpoints_us) do
    others =
      for %{us: us} = note <- moved,
          us >= way.since_us,
          note.ends? or not way.ends?,
          not (setpoint?(note) and setpoints_us != nil and setpoints_us < way.since_us),
          do: note

    own = if others == [], do: [], else: for(id <- way.ours, do: ids(id, vehicle))

    with %{} = note <-
           Enum.find(Enum.sort_by(others, & &1.us), &(not Enum.any?(own, fn ids -> &1.id in ids end))) do
      clock = note.at |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")
      "it was given #{note.type} by #{note.source} at #{clock} UTC; this operation left it alone"
    end
  end

  defp ids(id, vehicle), do: [command_id(id, vehicle) | for(n <- @numbers, do: command_id(id, vehicle, n))]

  defp setpoint?(%{type: type}), do: String.starts_with?(type, "setpoint_")

  defp setpoints_since(gateway, vehicle) do
    with ms when ms != nil <- RecentCommands.setpoints_ms(gateway, vehicle),
         do: System.monotonic_time(:microsecond) - ms * 1000
  end

  @doc "Whether a step may move the vehicle, or ends a flight."
  @spec moves?(term()) :: boolean()
  def moves?({:command, type, _params} = step),
    do: match?(%{moves_vehicle?: true}, Command.type(type)) or ends?(step)

  def moves?(_shadow), do: false

  @doc "Whether an operation by itself ends flights."
  @spec ends?(term()) :: boolean()
  def ends?({:command, type, _params}), do: type in Intent.ending()
  def ends?(_other), do: false

  @doc "The id of an operation's command, or of its step `n`: one that comes twice commands nobody twice."
  @spec command_id(operation :: String.t(), vehicle :: String.t(), n :: non_neg_integer() | nil) :: String.t()
  def command_id(operation, vehicle, n \\ nil) do
    name = if n, do: "#{operation} #{n}", else: operation
    <<short::binary-18, _rest::binary>> = :crypto.hash(:sha256, [name, 0, vehicle])
    "op-" <> Base.url_encode64(short)
  end
end
