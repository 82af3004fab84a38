defmodule Aerie.CLI.Subcommand.Mission do
  @moduledoc "`aerie mission show` and `clear` (`Aerie.Control.Missions`)."
  @behaviour Aerie.CLI.Subcommand

  alias Protocols.Mission.Plan
  alias MavCodec.Enums.{MavCmd, MavFrame}
  alias Aerie.Base.Json
  alias Aerie.Control.Missions
  alias Aerie.CLI.{Ask, Subcommand}
  alias Aerie.CLI.Output.Columns

  @impl Aerie.CLI.Subcommand
  def run(%{name: "mission show", arguments: %{"VEHICLE" => vehicle}, options: options} = request) do
    with {:ok, kind} <- kind(request) do
      case Missions.download(:default, vehicle, kind) do
        {:ok, stored} ->
          {0,
           if(options[:json],
             do: [Json.encode_to_iodata!(Missions.plain(stored, kind)), ?\n],
             else: rows(stored.items)
           )}

        error ->
          Subcommand.Command.answer(error, %{})
      end
    end
  end

  def run(%{name: "mission clear", arguments: %{"VEHICLE" => vehicle}, options: options} = request) do
    with {:ok, kind} <- kind(request), :ok <- Ask.first("remove the #{kind} of #{vehicle}", options) do
      Subcommand.Command.answer(
        Missions.clear(:default, vehicle, kind, as: Subcommand.Command.source(), via: "bin/aerie"),
        options
      )
    end
  end

  @doc "Sends a kind of a plan; runs in the gateway."
  @spec upload(String.t(), Missions.kind(), Plan.t(), force :: boolean()) ::
          {0..1, iodata()} | {:error, String.t()}
  def upload(vehicle, kind, plan, force) do
    :default
    |> Missions.upload(vehicle, kind, plan, force: force, as: Subcommand.Command.source(), via: "bin/aerie")
    |> Subcommand.Command.answer(%{})
  end

  @doc "The kind of plan that a request means."
  @spec kind(Aerie.CLI.Subcommand.request()) :: {:ok, Missions.kind()} | {:error, String.t()}
  def kind(%{arguments: arguments}) do
    name = arguments["KIND"] || "mission"

    case Enum.find(Missions.kinds(), &(Atom.to_string(&1) == name)) do
      nil -> {:error, "'#{name}': expected #{Enum.join(Missions.kinds(), ", ")}"}
      kind -> {:ok, kind}
    end
  end

  @doc "Items as a table. Pure."
  @spec rows([Protocols.Mission.Item.t()]) :: iodata()
  def rows(items) do
    rows =
      for {item, seq} <- Enum.with_index(items) do
        command = MavCmd.label(item.command) || item.command
        frame = MavFrame.label(item.frame) || item.frame
        [seq, command, frame, degrees(item.x), degrees(item.y), item.z | Tuple.to_list(item.params)]
      end

    Columns.render(~w(SEQ COMMAND FRAME LATITUDE LONGITUDE HEIGHT P1 P2 P3 P4), rows)
  end

  defp degrees(nil), do: nil
  defp degrees(scaled), do: scaled / 1.0e7
end
