defmodule Aerie.Vehicle.Command.Types do
  @moduledoc """
  The table of all commands, one `Aerie.Vehicle.Command.Type` a row, in the files of `types/`. Validation, `docs/commands.md`
  (`mix aerie.commands`), forms and the policy's reading of raw MAVLink are made from it. A new command is a row here and its steps
  in `Aerie.Vehicle.Protocol.Mavlink.Commands`, or in the adapter of a firmware that differs (`Aerie.Vehicle.Protocol`).
  """

  alias Aerie.Base.Json.Object
  alias Aerie.Vehicle.Command.{Type, Types}
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

  param = [
    {:name, :text, nil, "name of the parameter"},
    {:type, :text, nil, "number, integer, boolean, choice, text or list"},
    {:unit, :text, nil, "its unit"},
    {:min, :number, nil, "the least value, or length"},
    {:max, :number, nil, "the largest value, or length"},
    {:values, {:list, :any}, nil, "the values to choose from"},
    {:default, :any, nil, "what counts if it is not given; null: it is left out"},
    {:required, :boolean, nil, "whether it must be given"},
    {:meaning, :text, nil, "what it says"}
  ]

  item = Object.fields(param ++ [{:items, :any, nil, "null"}])
  params = Object.fields(param ++ [{:items, {:object, item}, nil, "what each item of a list is"}])

  @fields Object.fields([
            {:name, :text, nil, "name of the command"},
            {:group, :text, nil, "what it belongs to"},
            {:meaning, :text, nil, "what it does"},
            {:permission, :text, nil, "what a source must be allowed to do"},
            {:retry, {:one_of, [:safe, :never]}, nil, "whether it is sent again when no answer comes"},
            {:confirmed_by, :text, nil, "what of the vehicle's state shows that it was done"},
            {:long, :boolean, nil, "whether the vehicle may take seconds or minutes", :long?},
            {:cancel, :boolean, nil, "whether it can be cancelled while it runs", :cancel?},
            {:moves_vehicle, :boolean, nil, "whether the vehicle or its propellers may move because of it",
             :moves_vehicle?},
            {:rules, {:list, :text}, nil, "rules about several parameters", &__MODULE__.rules/1},
            {:params, {:list, {:object, params}}, nil, "its parameters"}
          ])

  @doc "What is shown of a row."
  @spec fields() :: [Object.t()]
  def fields, do: @fields

  @doc false
  @spec rules(Type.t()) :: [String.t()]
  def rules(%Type{rules: rules}), do: Enum.map(rules, &Type.rule_text/1)
end
