defmodule Aerie.Fleet.Operations.Request do
  @moduledoc """
  An operation as it comes from outside, checked. Pure.

      {"id": "roll-7", "tag": "survey", "command": {"type": "rtl"}, "step": 5, "pause_s": 10, "halt_ratio": 0.2}
      {"vehicles": ["VID-001", "VID-002"], "shadow": {"desired": {"params": {"FENCE_ALT_MAX": 80}}}, "await": "converged"}

  | key | meaning | left out |
  |---|---|---|
  | `id` | the same id is the same operation | one is made; over NATS it must be there, where a request may come twice |
  | `vehicles`, or `tag` | which: at most 2,000 ids, or all with a tag when it begins | one of them must be there |
  | `command`, or `shadow` | a command's `type` and `params`, or a change of the desired state (docs/shadow.md) without `version` | one of them must be there |
  | `step` | how many at once, 1 to 100 | 20 |
  | `pause_s` | between two steps, 0 to 3,600 | 0 |
  | `halt_ratio` | the share of failures beyond which nothing begins any more, 0 to 1 | 1: go on |
  | `await` | of a shadow: `written`, or `converged` | `written` |
  | `timeout_s` | how long a vehicle may take to converge, 1 to 3,600, or a command until it is sent, 1 to 300 | 60 for a shadow, 5 more for each field and 600 for a plan; 10 for a command |
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.Command.Error
  alias Aerie.Fleet.Shadow.Update

  @keys ~w(id vehicles tag command shadow step pause_s halt_ratio await timeout_s)
  @max_vehicles 2_000

  @enforce_keys [:id, :targets, :what, :plan, :timeout_ms]
  defstruct [:id, :targets, :what, :plan, :timeout_ms, await: :written]

  @type t :: %__MODULE__{
          id: String.t(),
          targets: {:vehicles, [String.t(), ...]} | {:tag, String.t()},
          what: {:command, String.t(), map()} | {:shadow, map()},
          plan: %{step: pos_integer(), pause_ms: non_neg_integer(), halt_ratio: float()},
          timeout_ms: pos_integer(),
          await: :written | :converged
        }

  @doc "The most vehicles of one operation."
  @spec max_vehicles() :: pos_integer()
  def max_vehicles, do: @max_vehicles

  @doc "Reads an operation at `now` (unix microseconds), or says all that is wrong with it."
  @spec parse(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse(%{} = object, now) do
    checks = [
      id: id(object),
      targets: targets(object),
      what: what(object, now),
      step: number(object, "step", 1..100, 20, &is_integer/1),
      pause_s: number(object, "pause_s", 0..3_600, 0, &is_number/1),
      halt_ratio: number(object, "halt_ratio", 0..1, 1, &is_number/1),
      await: await(object),
      timeout_s: timeout_s(object)
    ]

    unknown =
      for key <- Map.keys(object),
          key not in @keys,
          do: Error.new(Error.key(key), "one of #{Enum.join(@keys, ", ")}", :unknown)

    case unknown ++ Enum.flat_map(checks, fn {_name, check} -> errors(check) end) do
      [] ->
        got = Map.new(checks, fn {name, {:ok, value}} -> {name, value} end)

        {:ok,
         %__MODULE__{
           id: got.id,
           targets: got.targets,
           what: got.what,
           plan: %{step: got.step, pause_ms: round(got.pause_s * 1000), halt_ratio: got.halt_ratio / 1},
           timeout_ms: round(got.timeout_s * 1000),
           await: got.await
         }}

      errors ->
        {:error, errors}
    end
  end

  def parse(other, _now), do: {:error, [Error.new("operation", "an object", other)]}

  defp errors({:ok, _value}), do: []
  defp errors({:error, errors}), do: List.wrap(errors)

  defp id(%{"id" => id}) when is_binary(id) do
    if byte_size(id) <= 32 and Command.token?(id), do: {:ok, id}, else: wrong_id(id)
  end

  defp id(%{"id" => id}), do: wrong_id(id)
  defp id(_none), do: {:ok, Command.id()}

  defp wrong_id(id), do: {:error, Error.new("id", "1 to 32 letters, digits, - and _", id)}

  defp targets(%{"vehicles" => _both, "tag" => _given}),
    do: {:error, Error.new("tag", "either vehicles or a tag", :rule)}

  defp targets(%{"vehicles" => [_ | _] = ids}) when length(ids) <= @max_vehicles do
    case Enum.reject(ids, &(is_binary(&1) and Command.token?(&1))) do
      [] -> {:ok, {:vehicles, Enum.uniq(ids)}}
      [odd | _more] -> {:error, Error.new("vehicles", "ids of vehicles", odd)}
    end
  end

  defp targets(%{"vehicles" => other}),
    do: {:error, Error.new("vehicles", "a list of 1 to #{@max_vehicles} ids", other)}

  defp targets(%{"tag" => tag}) do
    if Json.text?(tag, 1, 64),
      do: {:ok, {:tag, tag}},
      else: {:error, Error.new("tag", "a text of 1 to 64 characters", tag)}
  end

  defp targets(_none), do: {:error, Error.new("vehicles", "vehicles, or a tag", :missing)}

  defp what(%{"command" => _both, "shadow" => _given}, _now),
    do: {:error, Error.new("shadow", "either a command or a shadow", :rule)}

  defp what(%{"command" => %{"params" => params}}, _now) when params != nil and not is_map(params),
    do: {:error, Error.new("command.params", "an object", params)}

  # As a command for a vehicle that any name may be; each is parsed again with its own.
  defp what(%{"command" => %{"type" => type} = command}, _now) do
    with [] <- Map.keys(command) -- ["type", "params"],
         {:ok, _command} <- Command.new(vehicle: "V", type: type, params: Map.get(command, "params") || %{}) do
      {:ok, {:command, type, Map.get(command, "params") || %{}}}
    else
      {:error, errors} -> {:error, for(error <- errors, do: %{error | key: "command." <> error.key})}
      [key | _more] -> {:error, Error.new("command." <> Error.key(key), "only type and params", :unknown)}
    end
  end

  defp what(%{"command" => other}, _now), do: {:error, Error.new("command", "an object with a type", other)}

  defp what(%{"shadow" => %{"version" => _one}}, _now),
    do: {:error, Error.new("shadow.version", "no version: each vehicle has another", :rule)}

  defp what(%{"shadow" => shadow}, now) do
    case Update.parse(shadow, now) do
      {:ok, _update} -> {:ok, {:shadow, shadow}}
      {:error, errors} -> {:error, for(error <- errors, do: %{error | key: "shadow." <> error.key})}
    end
  end

  defp what(_none, _now), do: {:error, Error.new("command", "a command, or a shadow", :missing)}

  defp number(object, key, first..last//_step, absent, kind?) do
    case Map.get(object, key, absent) do
      value when value >= first and value <= last and is_number(value) ->
        if kind?.(value), do: {:ok, value}, else: {:error, Error.new(key, "a whole number", value)}

      other ->
        {:error, Error.new(key, "a number from #{first} to #{last}", other)}
    end
  end

  # By a slow radio a field takes seconds, and a plan minutes.
  defp timeout_s(%{"shadow" => shadow} = object) do
    desired = if is_map(shadow) and is_map(shadow["desired"]), do: shadow["desired"], else: %{}
    fields = for {_name, value} <- desired, do: if(is_map(value), do: map_size(value), else: 1)
    plans = Enum.count(desired, fn {_name, value} -> is_map(value) and is_map_key(value, "plan") end)
    number(object, "timeout_s", 1..3_600, min(60 + 5 * Enum.sum(fields) + 600 * plans, 3_600), &is_number/1)
  end

  defp timeout_s(object), do: number(object, "timeout_s", 1..300, 10, &is_number/1)

  defp await(%{"await" => _any, "command" => _given}),
    do: {:error, Error.new("await", "nothing: a command has its own end", :rule)}

  defp await(%{"await" => "written"}), do: {:ok, :written}
  defp await(%{"await" => "converged"}), do: {:ok, :converged}
  defp await(%{"await" => other}), do: {:error, Error.new("await", "written or converged", other)}
  defp await(_none), do: {:ok, :written}
end
