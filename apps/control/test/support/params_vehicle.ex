defmodule Aerie.ParamsVehicle do
  @moduledoc "A model of a vehicle's parameters for `Aerie.LossyLink`: list, read, set, `_HASH_CHECK`."

  alias Aerie.Control.Params.Param
  alias MavCodec.Message.ParamValue
  alias MavCodec.Messages, as: M
  alias Protocols.Params.Listing

  defstruct encoding: :c_cast, params: [], history: %{}, pace: 2_000, stuck: [], clamp: %{}, writes: 0

  @doc "With parameters as `{name, value, type}`, in the order of their indices."
  def new(params, more \\ []), do: struct!(%__MODULE__{params: params}, more) |> remember()

  @doc "Some parameters, of all types."
  def some(n) do
    for i <- 1..n do
      type = Enum.at([2, 4, 6, 9], rem(i, 4))
      {"P#{i}", if(type == 9, do: ParamValue.float32(i / 7), else: rem(i * 37, 100)), type}
    end
  end

  @doc "Sets a value as if somebody else had."
  def put(vehicle, name, value) do
    params = Enum.map(vehicle.params, fn {n, v, t} -> {n, if(n == name, do: value, else: v), t} end)
    remember(%{vehicle | params: params})
  end

  @doc "A parameter appears, at an index in the middle (P7)."
  def appear(vehicle, at, param), do: remember(%{vehicle | params: List.insert_at(vehicle.params, at, param)})

  @doc "One disappears."
  def vanish(vehicle, name), do: %{vehicle | params: Enum.reject(vehicle.params, &(elem(&1, 0) == name))}

  @doc "Every value that a parameter has had."
  def had?(vehicle, %Param{name: name, value: value}), do: value in Map.get(vehicle.history, name, [])

  @doc "For `Aerie.LossyLink.run/5`."
  def answer(v, %M.ParamRequestList{}, _now) do
    head = if v.encoding == :bytewise, do: [hash(v)], else: []
    values = head ++ for {_param, index} <- Enum.with_index(v.params), do: value(v, index)
    {v, for({message, n} <- Enum.with_index(values), do: {n * v.pace, message})}
  end

  def answer(%{encoding: :bytewise} = v, %M.ParamRequestRead{param_id: "_HASH_CHECK"}, _now),
    do: {v, [{0, hash(v)}]}

  def answer(v, %M.ParamRequestRead{param_index: -1, param_id: name}, _now) do
    case index(v, name) do
      nil -> {v, []}
      index -> {v, [{0, %{value(v, index) | param_index: 65_535}}]}
    end
  end

  def answer(v, %M.ParamRequestRead{param_index: index}, _now),
    do: {v, if(index < length(v.params), do: [{0, value(v, index)}], else: [])}

  def answer(v, %M.ParamSet{param_id: name} = m, _now) do
    case Enum.find(v.params, &(elem(&1, 0) == name)) do
      nil ->
        {v, []}

      {^name, _old, type} when v.encoding == :bytewise and type != m.param_type ->
        {v, []}

      {^name, _old, type} ->
        {:ok, wanted, true} = ParamValue.decode(m.param_value, type, v.encoding)
        wanted = min(wanted, Map.get(v.clamp, name, wanted))
        v = if name in v.stuck, do: v, else: put(%{v | writes: v.writes + 1}, name, wanted)
        {v, [{0, %{value(v, index(v, name)) | param_index: 65_535}}]}
    end
  end

  def answer(v, _other, _now), do: {v, []}

  defp index(v, name), do: Enum.find_index(v.params, &(elem(&1, 0) == name))

  # A value that is not a number has no encoding.
  defp value(v, index) do
    case Enum.at(v.params, index) do
      {name, value, type} when is_number(value) -> Listing.value(listing(v), name, value, type)
      {name, special, type} -> %{Listing.value(listing(v), name, 0, type) | param_value: special}
    end
  end

  @doc "`_HASH_CHECK` as a message."
  def hash(v), do: Listing.hash(%{listing(v) | encoding: :bytewise}, :erlang.phash2(v.params))

  defp listing(v), do: Listing.new(Enum.map(v.params, &elem(&1, 0)), v.encoding)

  defp remember(v) do
    history =
      Enum.reduce(v.params, v.history, fn {n, value, _t}, h -> Map.update(h, n, [value], &[value | &1]) end)

    %{v | history: history}
  end
end
