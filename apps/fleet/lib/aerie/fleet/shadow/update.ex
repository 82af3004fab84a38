defmodule Aerie.Fleet.Shadow.Update do
  @moduledoc """
  A change of a desired state as it comes over NATS and REST, checked against the table of fields:

      {"desired": {"mode": "LOITER", "params": {"FENCE_ALT_MAX": 80, "RTL_ALT": null}},
       "version": 12, "reason": "storm", "expires_in_s": 3600, "token": "tablet-3"}

  Only the given fields change; null removes one, or all fields of a group (Z1). `version` is the version that the change is
  based on, `token` is returned in the answer (Z3). All keys except `desired` are optional.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command.Error
  alias Aerie.Fleet.Shadow.Document.Field

  @enforce_keys [:changes]
  defstruct [:changes, :version, :reason, :expires_at, :token]

  @typedoc """
    * `:changes` - values by their paths, nil to remove one; the path `params.*` removes the group
    * `:expires_at` - unix microseconds, nil for never
  """
  @type t :: %__MODULE__{
          changes: %{Field.path() => term()},
          version: non_neg_integer() | nil,
          reason: String.t() | nil,
          expires_at: integer() | nil,
          token: String.t() | nil
        }

  @keys ~w(desired version reason expires_at expires_in_s token)
  @max_errors 8
  @max_text %{reason: 200, token: 64}
  @max_expiry_s 31_536_000
  @second 1_000_000

  @doc "Reads an update at `now` (unix microseconds): the update, or its errors."
  @spec parse(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse(object, now), do: parse(object, now, &changes(&1["desired"]))

  @doc "Reads the request to remove all fields: the same keys without `desired`."
  @spec parse_delete(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse_delete(object, now) do
    parse(object, now, fn
      %{"desired" => _any} ->
        {:error, [Error.new("desired", "nothing: a deletion removes all fields", :unknown)]}

      _object ->
        {:ok, Map.new(Field.all(), &{&1.name, nil})}
    end)
  end

  @doc "The longest expiry in seconds, and the most characters of the texts."
  @spec limits() :: {pos_integer(), %{reason: pos_integer(), token: pos_integer()}}
  def limits, do: {@max_expiry_s, @max_text}

  defp parse(object, now, changes) when is_map(object) do
    checks = [
      changes: changes.(object),
      version: version(object["version"]),
      reason: text("reason", object["reason"], @max_text.reason),
      token: text("token", object["token"], @max_text.token),
      expires_at: expiry(object, now)
    ]

    case unknown(object) ++ for({_name, {:error, errors}} <- checks, error <- errors, do: error) do
      [] -> {:ok, struct!(__MODULE__, for({name, {:ok, value}} <- checks, do: {name, value}))}
      errors -> {:error, Enum.take(errors, @max_errors)}
    end
  end

  defp parse(other, _now, _changes), do: {:error, [Error.new("shadow", "an object", other)]}

  defp changes(desired) when is_map(desired) and map_size(desired) > 0 do
    {changes, errors} = Enum.reduce(desired, {%{}, []}, &top/2)

    if errors == [], do: {:ok, changes}, else: {:error, Enum.reverse(errors)}
  end

  defp changes(other),
    do: {:error, [Error.new("desired", "an object with fields", if(other == nil, do: :missing, else: other))]}

  defp top({name, value}, acc) do
    cond do
      name not in Field.groups() ->
        leaf(name, value, acc)

      value == nil ->
        Enum.reduce(Field.all(), acc, &group(&1, name, &2))

      is_map(value) and map_size(value) > Map.get(Field.max_of_group(), name, 250) ->
        most = "at most #{Field.max_of_group()[name]} fields at once"
        wrong(acc, Error.new("desired." <> name, most, map_size(value)))

      is_map(value) ->
        Enum.reduce(value, acc, fn {child, value}, acc -> leaf("#{name}.#{child}", value, acc) end)

      true ->
        wrong(acc, Error.new("desired." <> name, "an object or null", value))
    end
  end

  defp group(field, name, {changes, errors}) do
    if String.starts_with?(field.name, name <> "."),
      do: {Map.put(changes, field.name, nil), errors},
      else: {changes, errors}
  end

  defp leaf(path, value, {changes, errors} = acc) do
    with {:ok, field} <- Field.fetch(path),
         {:ok, value} <- if(value == nil, do: {:ok, nil}, else: Field.check(field, path, value)) do
      {Map.put(changes, path, value), errors}
    else
      :error -> wrong(acc, Error.new(Error.key("desired." <> path), expected(path), :unknown))
      {:error, [error | _more]} -> wrong(acc, error)
    end
  end

  defp expected("params." <> _name),
    do: "the name of a parameter: a letter, then letters, digits and _, at most 16, or 64 small ones"

  defp expected("intervals." <> _name), do: "the name of a message, such as ATTITUDE"
  defp expected("geofence." <> _name), do: "only enabled, plan"
  defp expected("mission." <> _name), do: "only plan"
  defp expected(_name), do: "only #{Enum.join(Field.names(), ", ")}"

  # Further errors are dropped, so that a nonsensical document costs no more than its size.
  defp wrong({changes, errors}, error), do: {changes, Enum.take([error | errors], @max_errors)}

  defp version(nil), do: {:ok, nil}
  defp version(version) when is_integer(version) and version >= 0, do: {:ok, version}
  defp version(other), do: {:error, [Error.new("version", "the number of a version", other)]}

  defp text(_key, nil, _max), do: {:ok, nil}

  defp text(key, text, max) do
    if Json.text?(text, 0, max),
      do: {:ok, text},
      else: {:error, [Error.new(key, "a text of at most #{max} characters", text)]}
  end

  defp expiry(%{"expires_at" => at, "expires_in_s" => seconds}, _now) when at != nil and seconds != nil,
    do: {:error, [Error.new("expires_at", "either expires_at or expires_in_s", :rule)]}

  defp expiry(%{"expires_in_s" => seconds}, now) when seconds != nil do
    if is_number(seconds) and seconds >= 1 and seconds <= @max_expiry_s,
      do: {:ok, now + round(seconds * @second)},
      else: {:error, [Error.new("expires_in_s", "a number from 1 to #{@max_expiry_s} (s)", seconds)]}
  end

  defp expiry(%{"expires_at" => text}, now) when text != nil do
    with true <- is_binary(text) and byte_size(text) <= 64,
         {:ok, time, _offset} <- DateTime.from_iso8601(text),
         at = DateTime.to_unix(time, :microsecond),
         true <- at > now and at <= now + @max_expiry_s * @second do
      {:ok, at}
    else
      _other ->
        {:error, [Error.new("expires_at", "a time in the coming year such as 2026-11-22T09:00:00Z", text)]}
    end
  end

  defp expiry(_never, _now), do: {:ok, nil}

  defp unknown(object) do
    for key <- Map.keys(object) |> Enum.reject(&(&1 in @keys)) |> Enum.take(@max_errors),
        do: Error.new(Error.key(key), "only #{Enum.join(@keys, ", ")}", :unknown)
  end
end
