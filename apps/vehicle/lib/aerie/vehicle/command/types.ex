defmodule Aerie.Vehicle.Command.Types do
  @moduledoc """
  The table of all commands, one `Aerie.Vehicle.Command.Type` a row, in the files of `types/`. Validation, `docs/commands.md`
  (`mix aerie.commands`), forms and the policy's reading of raw MAVLink are made from it. A new command is a row here and its steps
  in `Aerie.Vehicle.Protocol.Mavlink.Commands`, or in the adapter of a firmware that differs (`Aerie.Vehicle.Protocol`).
  """

  alias Aerie.Vehicle.Command.{Param, Type, Types}
  alias MavCodec.Enums.MavCmd

  @all Types.Flight.rows() ++
         Types.Navigation.rows() ++
         Types.Mission.rows() ++
         Types.Payload.rows() ++
         Types.Manual.rows() ++ Types.Maintenance.rows() ++ Types.Control.rows()
  @by_name Map.new(@all, &{&1.name, &1})
  @by_mav_cmd for type <- @all,
                  name <- type.mav_cmds,
                  into: %{},
                  do: {MavCmd.value(:"MAV_CMD_#{name}") || raise("no command #{name}"), type.name}

  @doc "All rows, in an order for people."
  @spec all() :: [Type.t()]
  def all, do: @all

  @doc "All names."
  @spec names() :: [String.t()]
  def names, do: Enum.map(@all, & &1.name)

  @doc "The row of a name from outside."
  @spec fetch(term()) :: {:ok, Type.t()} | :error
  def fetch(name), do: Map.fetch(@by_name, name)

  @doc "The row of a name that is known."
  @spec fetch!(String.t()) :: Type.t()
  def fetch!(name), do: Map.fetch!(@by_name, name)

  @doc "The name of the row that a command of MAV_CMD belongs to, nil if it has none of its own."
  @spec name_of_mav_cmd(integer()) :: String.t() | nil
  def name_of_mav_cmd(id), do: Map.get(@by_mav_cmd, id)

  @doc "The table as JSON has it: for forms, and for programs that want to know what can be commanded."
  @spec plain() :: [%{String.t() => term()}]
  def plain, do: Enum.map(@all, &plain/1)

  defp plain(%Type{} = type) do
    %{
      "name" => type.name,
      "group" => Atom.to_string(type.group),
      "meaning" => type.meaning,
      "permission" => Atom.to_string(type.permission),
      "retry" => Atom.to_string(type.retry),
      "confirmed_by" => type.confirmed_by,
      "long" => type.long?,
      "cancel" => type.cancel?,
      "moves_vehicle" => type.moves_vehicle?,
      "rules" => Enum.map(type.rules, &Type.rule_text/1),
      "params" => Enum.map(type.params, &plain/1)
    }
  end

  defp plain(%Param{} = param) do
    %{
      "name" => Atom.to_string(param.name),
      "type" => Atom.to_string(param.type),
      "unit" => param.unit,
      "min" => param.min,
      "max" => param.max,
      "values" => param.values,
      "default" => param.default,
      "required" => param.required,
      "meaning" => param.meaning,
      "items" => param.items && plain(param.items)
    }
  end
end
