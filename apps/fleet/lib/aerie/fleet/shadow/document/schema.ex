defmodule Aerie.Fleet.Shadow.Document.Schema do
  @moduledoc """
  JSON Schemas of the shadow's requests, answers and documents, from the table of fields (`Aerie.Fleet.Shadow.Document.Field`). What the schema of a
  change takes, `Aerie.Fleet.Shadow.Update` takes, but for `expires_at`, which must be in the coming year. Pure.
  """

  import Aerie.Base.Json.Schema

  alias Aerie.Fleet.Shadow.Update
  alias Aerie.Fleet.Shadow.Document.{Field, Report}
  alias Aerie.Vehicle.Command
  alias Aerie.Vehicle.State.{Fields, Groups}
  alias Aerie.Vehicle.Command.Param
  alias MavRouter.Endpoints.RuleChanges

  @type t :: Aerie.Base.Json.Schema.t()

  @hash "^[0-9a-f]{64}$"
  @param "^([A-Za-z][A-Za-z0-9_]{0,15}|[a-z][a-z0-9_]{0,63})$"
  @states ~w(converged pending held refused)

  @doc "The schemas that the others refer to, by their names."
  @spec shared() :: %{String.t() => t()}
  def shared do
    %{
      "message_name" => RuleChanges.message_name(),
      "desired_fields" => desired(&nullable/1),
      "actual_fields" => desired(& &1)
    }
  end

  defp desired(value) do
    fields = Enum.group_by(Field.all(), &hd(String.split(&1.name, ".")))
    properties = Map.new(fields, fn {name, rows} -> {name, value.(field(name, rows, value))} end)
    object(properties, [])
  end

  defp field(name, [%{name: name} = row], _value), do: leaf(row)

  defp field(name, rows, value) do
    children = for row <- rows, do: {String.replace_prefix(row.name, name <> ".", ""), leaf(row)}

    case children do
      [{"*", one}] ->
        most = Field.max_of_group()[name]
        %{type: :object, propertyNames: names(name), additionalProperties: value.(one), maxProperties: most}

      children ->
        object(Map.new(children, fn {child, one} -> {child, value.(one)} end))
    end
  end

  defp names("params"), do: %{pattern: @param}
  defp names("intervals"), do: ref("message_name")

  defp leaf(%{check: {:object, params}} = row) do
    properties = Map.new(params, &{&1.name, Command.Schema.param(&1)})
    properties |> object(for(%{required: true, name: name} <- params, do: name)) |> described(row.meaning)
  end

  defp leaf(%{name: name} = row) when name in ["mission.plan", "geofence.plan"],
    do: described(%{type: :string, pattern: @hash}, row.meaning)

  defp leaf(%{check: %Param{} = param} = row),
    do: %{param | meaning: row.meaning} |> Command.Schema.param()

  @doc "A change."
  @spec update() :: t()
  def update, do: change(%{desired: %{allOf: [ref("desired_fields"), %{minProperties: 1}]}}, [:desired])

  @doc "The request to remove all fields."
  @spec delete() :: t()
  def delete, do: change(%{}, [])

  defp change(properties, required) do
    version = described(%{type: :integer, minimum: 0}, "the document's version that this is based on")
    {most, text} = Update.limits()

    object(
      Map.merge(properties, %{
        version: nullable(version),
        reason: described(nullable(text(text.reason, 0)), "a text for people"),
        token: described(nullable(text(text.token, 0)), "is returned in the answer"),
        expires_at: described(nullable(time()), "when the fields are removed; in the coming year"),
        expires_in_s: described(nullable(number(1, most)), "the same, counted from now", "s")
      }),
      required,
      anyOf: for(key <- [:expires_at, :expires_in_s], do: %{properties: %{key => %{type: :null}}})
    )
  end

  @doc "What a signed change over NATS must have, so that a copy of it changes nothing."
  @spec version_of_signed() :: {String.t(), :signed, String.t()}
  def version_of_signed,
    do:
      {"version", :signed, "version: a signed change names the version that it is meant for, as get gives it"}

  @doc "The desired document in its bucket. `seal` protects it: a gateway refuses what others wrote."
  @spec document() :: t()
  def document do
    entry =
      object(
        Map.merge(author(), %{value: %{}, expires_at: nullable(stamp())}),
        [:value, :version, :at, :actor, :via],
        open: true
      )

    object(
      %{
        vehicle: token(),
        version: version(),
        updated_at: nullable(stamp()),
        fields: described(%{type: :object, additionalProperties: entry}, "by paths such as `params.RTL_ALT`"),
        history: %{type: :array, maxItems: 20, items: entry_of_history()},
        seal: %{type: :string, pattern: @hash}
      },
      [:vehicle, :version, :fields, :history, :seal],
      open: true
    )
  end

  defp entry_of_history do
    paths = %{type: :array, items: %{type: :string}}

    object(Map.merge(author(), %{set: paths, removed: paths}), [:version, :at, :actor, :via, :set, :removed],
      open: true
    )
  end

  defp author do
    %{
      version: %{type: :integer, minimum: 1},
      at: stamp(),
      actor: described(%{type: :string}, "who set it"),
      via: described(%{type: :string}, "by which interface"),
      reason: %{type: [:string, :null]}
    }
  end

  @doc "The reported document."
  @spec reported() :: t()
  def reported do
    %{properties: actual} = desired(& &1)

    own = %{
      vehicle: token(),
      gateway: described(%{type: :string}, "the gateway that acts on the vehicle"),
      at: stamp(),
      desired_version: version(),
      in_air: %{type: [:boolean, :null]},
      status: %{enum: ~w(online stale lost)},
      autopilot: %{type: :string},
      type: %{type: [:string, :null]},
      firmware: %{type: [:string, :null]},
      capabilities: described(%{type: [:integer, :null]}, "MAV_PROTOCOL_CAPABILITY flags"),
      links: %{type: :array, items: %{type: :string}},
      health: health(),
      fields: fields(),
      holds: described(%{type: :array, items: hold()}, "what holds the shadow off"),
      omitted_fields:
        described(
          %{type: :integer, minimum: 1},
          "how many `fields` are left out because the document would be too large"
        )
    }

    # What the vehicle has may be outside of what can be desired.
    loose = Map.new(actual, fn {name, schema} -> {name, loose(schema)} end)
    required = Map.keys(own) -- [:omitted_fields]
    object(Map.merge(loose, own), required, open: true)
  end

  defp loose(%{properties: properties} = schema) do
    properties = Map.new(properties, fn {name, one} -> {name, loose(one)} end)
    Map.merge(Map.take(schema, [:description]), object(properties, [], open: true))
  end

  defp loose(%{additionalProperties: one}), do: %{type: :object, additionalProperties: loose(one)}
  defp loose(%{type: type} = schema), do: schema |> Map.take([:description]) |> Map.put(:type, type)
  defp loose(%{enum: _values} = schema), do: schema |> Map.take([:description]) |> Map.put(:type, :boolean)

  defp health do
    group = Enum.find(Groups.all(), &(&1.name == :health))

    group
    |> Fields.Schema.group()
    |> Map.fetch!(:properties)
    |> Map.take(Report.health())
    |> object([], open: true)
  end

  defp fields, do: %{type: :object, additionalProperties: state()}

  defp state do
    object(
      %{
        state: %{enum: @states},
        by: described(%{type: :string}, "what holds it: rc, failsafe, operator, …"),
        until: nullable(stamp()),
        why: %{type: :string},
        desired: %{},
        version: %{type: :integer, minimum: 1}
      },
      [:state, :desired, :version],
      open: true
    )
  end

  defp hold,
    do:
      object(%{by: %{type: :string}, until: nullable(stamp()), why: %{type: :string}}, [:by, :until, :why],
        open: true
      )

  @doc "The properties of answers by action, without those of a refusal."
  @spec answers() :: %{atom() => %{atom() => t()}}
  def answers do
    entry =
      object(Map.merge(author(), %{expires_at: nullable(stamp())}), [:version, :at, :actor, :via], open: true)

    desired = %{
      vehicle: token(),
      version: version(),
      updated_at: nullable(stamp()),
      desired: ref("actual_fields"),
      set: described(%{type: :object, additionalProperties: entry}, "who set each field, by its path")
    }

    token = described(%{type: [:string, :null]}, "that of the request")
    changed = Map.put(desired, :token, token)

    %{
      get:
        Map.merge(desired, %{
          history: %{type: :array, items: entry_of_history()},
          reported: %{anyOf: [ref("reported"), %{type: :null}]},
          problem: described(%{type: [:string, :null]}, "why documents cannot be stored at the moment")
        }),
      update: changed,
      delete: changed,
      delta: %{
        vehicle: token(),
        version: version(),
        delta:
          described(%{allOf: [ref("actual_fields")]}, "the desired values that differ, nested as in a change"),
        fields: fields()
      }
    }
  end

  defp version, do: %{type: :integer, minimum: 0}
  defp stamp, do: %{type: :string, format: :"date-time"}
end
