defmodule Aerie.Fleet.Shadow.Document.Field do
  @moduledoc """
  One field of a vehicle's desired state: which values are allowed, who may set it, in which order it is reconciled, and when the
  vehicle agrees with it. `all/0` is the table of all fields; validation uses it, and a test compares `docs/shadow.md` with it.

  A field is named by its path. `params.*` and `intervals.*` have one entry for each parameter and message.
  """

  alias MavCodec.Meaning.Shaping
  alias Aerie.Vehicle.Command.{Error, Param, Type}
  alias Aerie.Control.Params.LongNames
  alias Aerie.Control.Policy.Intent.Protection
  alias MavCodec.Dialects.All

  @enforce_keys [:name, :permission, :check, :stage, :meaning]
  defstruct [:name, :permission, :check, :stage, :meaning]

  @typedoc """
    * `:permission` - the permission that its author needs (`t:Aerie.Vehicle.Command.Type.permission/0`)
    * `:check` - checks a value from outside
    * `:stage` - the order: a stage waits for lower ones; stage 0 neither waits nor is waited for
  """
  @type t :: %__MODULE__{
          name: path(),
          permission: Type.permission(),
          check: Param.t() | {:object, [Param.t(), ...]},
          stage: 0..5,
          meaning: String.t()
        }
  @type path :: String.t()

  @place [
    Param.number(:lat, "°", -90, 90, "latitude", required: true),
    Param.number(:lon, "°", -180, 180, "longitude", required: true),
    Param.number(:altitude_msl, "m", -1000, 20_000, "height above mean sea level", required: true)
  ]
  # A SHA-256 as hexadecimal digits.
  @hash_bytes 64
  # Tolerances in degrees and metres: a vehicle stores home in 1e-7 degrees and centimetres, and may move it to its position.
  @home_deg 1.0e-5
  @home_m 1.0
  # As for streams: a rate this close to the requested one counts as equal.
  @rate_enough 0.6

  @all [
    %{
      name: "tags",
      permission: :telemetry,
      stage: 0,
      check: Param.list(:tags, Param.text(:tag, 64, "a tag"), 32, "tags"),
      meaning: "Words for people and programs; nothing is sent to the vehicle."
    },
    %{
      name: "recorder",
      permission: :telemetry,
      stage: 0,
      check: Param.boolean(:recorder, "recording"),
      meaning: "Whether the gateway records the vehicle's flight."
    },
    %{
      name: "intervals.*",
      permission: :telemetry,
      stage: 0,
      check: Param.number(:rate, "Hz", 0.001, 400, "rate"),
      meaning:
        "How often a message, by its name such as ATTITUDE, comes at least. Clients may want more; the highest rate counts."
    },
    %{
      name: "signing",
      permission: :maintain,
      stage: 0,
      check: Param.boolean(:signing, "signing", values: [true]),
      meaning: "The vehicle has the key that the gateway keeps for it. Needs a secure link (docs/signing.md)."
    },
    %{
      name: "params.*",
      permission: :maintain,
      stage: 1,
      check: Param.number(:value, nil, -3.4e38, 3.4e38, "value"),
      meaning: "A parameter of the vehicle by its name."
    },
    %{
      name: "geofence.plan",
      permission: :mission,
      stage: 2,
      check: Param.text(:plan, @hash_bytes, "hash"),
      meaning: "The fence that the vehicle stores, by the hash of its content."
    },
    %{
      name: "geofence.enabled",
      permission: :mission,
      stage: 2,
      check: Param.boolean(:enabled, "enabled"),
      meaning: "Whether the vehicle's fence is on."
    },
    %{
      name: "home",
      permission: :fly,
      stage: 2,
      check: {:object, @place},
      meaning: "Where home is."
    },
    %{
      name: "mission.plan",
      permission: :mission,
      stage: 3,
      check: Param.text(:plan, @hash_bytes, "hash"),
      meaning: "The mission that the vehicle stores, by the hash of its content."
    },
    %{
      name: "mode",
      permission: :fly,
      stage: 4,
      check: Param.text(:mode, 50, "mode"),
      meaning: "The flight mode, by the name that the vehicle's state shows."
    },
    %{
      name: "armed",
      permission: :arm,
      stage: 5,
      check: Param.boolean(:armed, "armed"),
      meaning: "Whether the vehicle is armed. Refused unless `shadow.allow_arming` is true."
    }
  ]
  @by_name Map.new(@all, &{&1.name, &1})
  @groups for %{name: name} <- @all, [group, _child] <- [String.split(name, ".")], uniq: true, do: group
  @leaves for %{name: name} <- @all, not String.contains?(name, "."), do: name

  @doc "All fields in the order in which they are reconciled."
  @spec all() :: [t()]
  def all, do: for(row <- @all, do: struct!(__MODULE__, row))

  @doc "The groups of fields: `params`, `geofence` …"
  @spec groups() :: [String.t()]
  def groups, do: @groups

  @doc "The top-level names of a desired state."
  @spec names() :: [String.t()]
  def names, do: @leaves ++ @groups

  @doc "The most fields that a group of any number of them may have, in a document and in a change."
  @spec max_of_group() :: %{String.t() => pos_integer()}
  def max_of_group, do: %{"params" => 250, "intervals" => 64}

  @doc "The field of a path; `:error` if there is none."
  @spec fetch(String.t()) :: {:ok, t()} | :error
  def fetch(path) do
    case {@by_name, String.split(path, ".", parts: 2)} do
      {%{^path => row}, _words} ->
        {:ok, struct!(__MODULE__, row)}

      {%{"params.*" => row}, ["params", name]} ->
        if param?(name), do: {:ok, struct!(__MODULE__, row)}, else: :error

      {%{"intervals.*" => row}, ["intervals", name]} ->
        if message?(name), do: {:ok, struct!(__MODULE__, row)}, else: :error

      _other ->
        :error
    end
  end

  defp param?(name), do: name =~ ~r/\A[A-Za-z][A-Za-z0-9_]*\z/ and LongNames.name?(name)
  defp message?(name), do: All.message_id(name) != nil

  @doc "The field of a path that was checked, or of a table row such as `params.*`."
  @spec fetch!(path()) :: t()
  def fetch!(path) do
    case @by_name do
      %{^path => row} ->
        struct!(__MODULE__, row)

      _several ->
        {:ok, field} = fetch(path)
        field
    end
  end

  @doc """
  All permissions that setting a field to a value needs: its own, and `protection` for what takes a protection away. A field is removed with
  its own alone (nil).
  """
  @spec permissions(path(), value :: term()) :: [Type.permission(), ...]
  def permissions(path, value), do: [fetch!(path).permission | besides(path, value)]

  defp besides("geofence.enabled", false), do: [:protection]
  defp besides("params." <> _name, nil), do: []

  # Whatever the limits are when it comes true.
  defp besides("params." <> name, _value),
    do: if(Protection.parameter?(name) or Shaping.shapes?(name), do: [:protection], else: [])

  defp besides(_path, _value), do: []

  @doc "Checks a value from outside."
  @spec check(t(), path(), term()) :: {:ok, term()} | {:error, [Error.t(), ...]}
  def check(%{check: {:object, params}} = field, path, value) do
    type = %Type{
      name: path,
      group: :flight,
      meaning: field.meaning,
      permission: field.permission,
      params: params
    }

    case Type.check(type, value) do
      {:ok, checked} -> {:ok, Map.new(checked, fn {name, number} -> {Atom.to_string(name), number} end)}
      {:error, errors} -> {:error, for(error <- errors, do: %{error | key: key(path, error.key)})}
    end
  end

  def check(%{name: name} = field, path, value) when name in ["mission.plan", "geofence.plan"] do
    if is_binary(value) and value =~ ~r/\A[0-9a-f]{64}\z/,
      do: {:ok, value},
      else:
        {:error,
         [Error.new("desired." <> path, "64 hexadecimal digits, #{field.check.meaning} of a plan", value)]}
  end

  def check(field, path, value) do
    with {:error, key, expected, got} <- Param.check(field.check, value, "desired." <> path),
         do: {:error, [Error.new(key, expected, got)]}
  end

  # The checks of a command call their object `params`.
  defp key(path, "params" <> rest), do: "desired." <> path <> rest

  @doc "Whether the vehicle's value (nil: not known) agrees with the desired one."
  @spec equal?(path(), desired :: term(), actual :: term()) :: boolean()
  def equal?(_path, _desired, nil), do: false
  def equal?("mode", desired, actual), do: String.upcase(desired) == String.upcase(actual)
  # PX4's integers are exact; every other parameter is a float of 32 bits.
  def equal?("params." <> _name, desired, actual) when is_integer(actual), do: desired == actual
  def equal?("params." <> _name, desired, actual), do: <<desired::float-32>> == <<actual::float-32>>
  def equal?("intervals." <> _name, desired, actual), do: actual >= desired * @rate_enough

  def equal?("home", desired, actual) do
    abs(desired["lat"] - actual["lat"]) <= @home_deg and abs(desired["lon"] - actual["lon"]) <= @home_deg and
      abs(desired["altitude_msl"] - actual["altitude_msl"]) <= @home_m
  end

  def equal?(_path, desired, actual), do: desired == actual

  @doc "Nests values that are given by their paths."
  @spec nested(%{path() => term()}) :: map()
  def nested(values) do
    Enum.reduce(values, %{}, fn {path, value}, object ->
      case String.split(path, ".", parts: 2) do
        [group, child] -> Map.update(object, group, %{child => value}, &Map.put(&1, child, value))
        [name] -> Map.put(object, name, value)
      end
    end)
  end
end
