defmodule Aerie.Vehicle.Command.Type do
  @moduledoc """
  One row of the table of commands (`Aerie.Vehicle.Command.Types`), and the check of a command's parameters by it.
  """

  alias MavCodec.Meaning.Commands.Row
  alias Aerie.Vehicle.Command.{Error, Param}

  @enforce_keys [:name, :group, :meaning, :permission]
  defstruct [
    :name,
    :group,
    :meaning,
    :permission,
    :confirmed_by,
    mav_cmds: [],
    params: [],
    rules: [],
    retry: :safe,
    long?: false,
    cancel?: false,
    moves_vehicle?: false,
    disarmed: :taken
  ]

  @typedoc "What a source must be allowed to do (`t:MavCodec.Meaning.Commands.Row.permission/0`)."
  @type permission :: Row.permission()

  @typedoc """
  A rule about several parameters: all or none of them; exactly one of them; at least one of them.
  """
  @type rule :: {:together, [atom()]} | {:one_of, [atom()]} | {:any_of, [atom()]}

  @typedoc """
    * `:mav_cmds` - the commands of MAV_CMD, without the prefix, that policy treats as this one when they come as raw MAVLink
    * `:retry` - `:safe`: sent again when no answer comes (C1); `:never`: sent once, because doing it twice is not the same
    * `:confirmed_by` - what of the vehicle's state shows that it was done; nil: nothing does, the vehicle's word is all there is
    * `:long?` - the vehicle may take seconds or minutes, and tell its progress (C4)
    * `:cancel?` - it can be cancelled while it runs (C5)
    * `:moves_vehicle?` - the vehicle or its propellers may move because of it
    * `:disarmed` - whether it is taken while the vehicle is disarmed. A vehicle may store it then, and drive off when it is armed:
      `:refused`; `:refused_on_wheels` - only by what drives or swims; `:refused_unless_first` - only
      by a firmware that does not want it before it is armed (X7)
  """
  @type t :: %__MODULE__{
          name: String.t(),
          group: :flight | :navigation | :mission | :payload | :manual | :maintenance | :telemetry | :control,
          meaning: String.t(),
          permission: permission(),
          confirmed_by: String.t() | nil,
          mav_cmds: [atom()],
          params: [Param.t()],
          rules: [rule()],
          retry: :safe | :never,
          long?: boolean(),
          cancel?: boolean(),
          moves_vehicle?: boolean(),
          disarmed: :taken | :refused | :refused_on_wheels | :refused_unless_first
        }

  @max_unknown 8

  @wheels ["rover", "boat", "sub"]

  @doc """
  Whether a disarmed vehicle of a kind may be given the command. `first?` - whether its firmware wants set-points before
  it is armed.
  """
  @spec taken_disarmed?(t(), first? :: boolean(), kind :: String.t() | nil) :: boolean()
  def taken_disarmed?(%{disarmed: :taken}, _first?, _kind), do: true
  def taken_disarmed?(%{disarmed: :refused}, _first?, _kind), do: false
  def taken_disarmed?(%{disarmed: :refused_on_wheels}, _first?, kind), do: kind not in @wheels
  def taken_disarmed?(%{disarmed: :refused_unless_first}, first?, _kind), do: first?

  @doc "All permissions that a command may need."
  @spec permissions() :: [permission()]
  defdelegate permissions, to: Row

  @doc """
  Checks parameters from outside, a map with text keys. Gives them by name with the defaults filled in, or all that is
  wrong with them.
  """
  @spec check(t(), term()) :: {:ok, %{atom() => term()}} | {:error, [Error.t(), ...]}
  def check(type, given) when is_map(given) and not is_struct(given) do
    {params, errors} = Enum.reduce(type.params, {%{}, []}, &take(&1, given, &2))

    case unknown(type, given) ++ Enum.reverse(errors) do
      [] -> rules(type, params)
      errors -> {:error, errors}
    end
  end

  def check(_type, given), do: {:error, [Error.new("params", "an object", given)]}

  defp take(param, given, {params, errors}) do
    key = Atom.to_string(param.name)

    case given do
      # null is the same as nothing: many programs cannot leave a field out.
      %{^key => value} when value != nil ->
        case Param.check(param, value, "params." <> key) do
          {:ok, value} -> {Map.put(params, param.name, value), errors}
          {:error, key, expected, got} -> {params, [Error.new(key, expected, got) | errors]}
        end

      _nothing when param.required ->
        {params, [Error.new("params." <> key, Param.expected(param), :missing) | errors]}

      _nothing when param.default == nil ->
        {params, errors}

      _nothing ->
        {Map.put(params, param.name, param.default), errors}
    end
  end

  defp unknown(type, given) do
    known = Enum.map(type.params, &Atom.to_string(&1.name))

    expected =
      if known == [],
        do: "no parameter, because #{type.name} has none",
        else: "only #{Enum.join(known, ", ")}"

    given
    |> Map.keys()
    |> Enum.reject(&(&1 in known))
    |> Enum.take(@max_unknown)
    |> Enum.map(&Error.new("params." <> Error.key(&1), expected, :unknown))
  end

  defp rules(type, params) do
    case for(rule <- type.rules, not kept?(rule, params), do: Error.new("params", rule_text(rule), :rule)) do
      [] -> {:ok, params}
      errors -> {:error, errors}
    end
  end

  defp kept?({:together, names}, params), do: count(names, params) in [0, length(names)]
  defp kept?({:one_of, names}, params), do: count(names, params) == 1
  defp kept?({:any_of, names}, params), do: count(names, params) > 0

  defp count(names, params), do: Enum.count(names, &is_map_key(params, &1))

  @doc "A rule in words."
  @spec rule_text(rule()) :: String.t()
  def rule_text({:together, names}), do: "all or none of #{Enum.join(names, ", ")}"
  def rule_text({:one_of, names}), do: "exactly one of #{Enum.join(names, ", ")}"
  def rule_text({:any_of, names}), do: "at least one of #{Enum.join(names, ", ")}"
end
