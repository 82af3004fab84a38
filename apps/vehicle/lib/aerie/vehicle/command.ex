defmodule Aerie.Vehicle.Command do
  @moduledoc """
  A command for a vehicle: `{id, vehicle, type, params, source, issued_at, deadline}`.

      {:ok, command} = Aerie.Vehicle.Command.parse(%{"id" => "a1", "vehicle" => "VID-001", "type" => "takeoff",
                         "params" => %{"altitude" => 20}, "source" => "ops"}, now)

  `Aerie.Vehicle.Command.Types` is the table of what can be commanded; a command that was parsed has parameters of that
  table only, in range, with defaults filled in. Times are unix microseconds.
  """

  alias Aerie.Base.Json
  alias Aerie.Vehicle.Command.{Deadline, Error, Refusal, Result, Type, Types}

  @enforce_keys [:id, :vehicle, :type, :source, :issued_at, :deadline]
  defstruct [:id, :vehicle, :type, :source, :sender, :issued_at, :deadline, params: %{}]

  @typedoc """
    * `:id` - chosen by the source, 1 to 64 letters, digits, `-` and `_` (it becomes part of a NATS subject)
    * `:vehicle` - the vehicle's name in the fleet
    * `:type` - a name of `Aerie.Vehicle.Command.Types`
    * `:params` - by the names of the type's parameters; what was not given and has no default is not there
    * `:source` - who says that it commands; who that is in truth, authentication decides
    * `:sender` - who gave it to the gateway that passed it on; nil for one that came directly
    * `:issued_at`, `:deadline` - nothing is sent to the vehicle from the deadline on
  """
  @type t :: %__MODULE__{
          id: String.t(),
          vehicle: String.t(),
          type: String.t(),
          params: %{atom() => term()},
          source: String.t(),
          sender: String.t() | nil,
          issued_at: integer(),
          deadline: integer()
        }

  # So much of a sender's name counts: a gateway that passes a command on has no room for more.
  @sender 48
  @keys ~w(id vehicle type params source issued_at deadline)
  # What an interface adds to the envelope and reads itself.
  @others ~w(signature key)
  @token "1 to 64 letters, digits, - and _"

  @doc """
  A command from a map with text keys, as NATS and REST bring it. `id`, `vehicle`, `type` and `source` must be there; an
  interface that knows some of them from elsewhere (a subject, a path) adds them. `params` may be missing, times as in
  `Aerie.Vehicle.Command.Deadline`.
  """
  @spec parse(term(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def parse(envelope, now) when is_map(envelope) and not is_struct(envelope) do
    checks = [
      id: token(envelope, "id"),
      vehicle: token(envelope, "vehicle"),
      source: source(envelope),
      issued_at: Deadline.issued_at(envelope["issued_at"], now),
      type: known_type(envelope)
    ]

    errors = unknown(envelope) ++ for {_name, {:error, error}} <- checks, do: error

    with [] <- errors,
         fields = Map.new(checks, fn {name, {:ok, value}} -> {name, value} end),
         {:ok, deadline} <- Deadline.deadline(envelope["deadline"], fields.issued_at, now),
         {:ok, params} <- Type.check(fields.type, Map.get(envelope, "params") || %{}) do
      {:ok,
       struct!(
         __MODULE__,
         %{fields | type: fields.type.name} |> Map.merge(%{deadline: deadline, params: params})
       )}
    else
      {:error, %Error{} = error} -> {:error, [error]}
      {:error, errors} -> {:error, errors}
      errors -> {:error, errors}
    end
  end

  def parse(envelope, _now), do: {:error, [Error.new("command", "an object", envelope)]}

  @doc """
  The command of the same fields for callers in Elixir: an id is made when none is given, `params` may have atoms as
  keys.
  """
  @spec new(keyword(), now :: integer()) :: {:ok, t()} | {:error, [Error.t(), ...]}
  def new(fields, now \\ System.os_time(:microsecond)) do
    fields
    |> Map.new(fn {name, value} -> {Atom.to_string(name), value} end)
    |> Map.update("params", %{}, &named/1)
    |> Map.put_new_lazy("id", &id/0)
    |> Map.put_new("source", "elixir")
    |> parse(now)
  end

  # Anything else is left to the check.
  defp named(params) do
    if is_map(params) or Keyword.keyword?(params),
      do: Map.new(params, fn {name, value} -> {to_string(name), value} end),
      else: params
  end

  @doc "A new id, unique without anybody being asked."
  @spec id() :: String.t()
  def id, do: Base.url_encode64(:crypto.strong_rand_bytes(12), padding: false)

  @doc "Checks the parameters of a type before there is a command, for a form."
  @spec check(Type.t(), term()) :: {:ok, %{atom() => term()}} | {:error, [Error.t(), ...]}
  defdelegate check(type, params), to: Type

  @doc "A refusal's text for the console's pages, which have a form in place of `take_control`."
  @spec on_pages(String.t()) :: String.t()
  defdelegate on_pages(text), to: Refusal.Policy

  @doc "The rows of all types, in an order for people."
  @spec types() :: [Type.t()]
  defdelegate types, to: Types, as: :all

  @doc "What is shown of a row."
  @spec type_fields() :: [Json.Object.t()]
  defdelegate type_fields, to: Types, as: :fields

  @doc "The row of a command's type, or of a name from outside; nil if no command has this name."
  @spec type(t() | term()) :: Type.t() | nil
  def type(%__MODULE__{type: name}), do: Types.fetch!(name)

  def type(name) do
    case Types.fetch(name) do
      {:ok, type} -> type
      :error -> nil
    end
  end

  @doc """
  What the command says, as 64 hexadecimal digits: vehicle, type, parameters and who gave it. Two envelopes with
  one id are the same command when their digests are equal; id and times do not count, so a repetition may have
  a later deadline, nor does the gateway that passed it on.
  """
  @spec digest(t()) :: String.t()
  def digest(command) do
    # Lists, because the order of an object's keys is not defined.
    params = for {name, value} <- Enum.sort(command.params), do: [name, value]
    sender = String.slice(command.sender || command.source, 0, @sender)
    text = JSON.encode!([command.vehicle, command.type, params, sender])
    :sha256 |> :crypto.hash(text) |> Base.encode16(case: :lower)
  end

  @doc """
  What a gateway that passes a command on says of its sender: the name and the interface by which it came.
  Longer names are cut.

      iex> Aerie.Vehicle.Command.passed_on("ops", "rest")
      "ops by rest"
  """
  @spec passed_on(name :: String.t(), via :: String.t()) :: String.t()
  def passed_on(name, via), do: "#{String.slice(name, 0, @sender)} by #{String.slice(via, 0, 8)}"

  @doc "The sender that a gateway named with `passed_on/2`; nil for any other text."
  @spec sender(String.t() | nil) :: String.t() | nil
  def sender(text) when is_binary(text) do
    case Regex.run(~r/\A(.+) by [a-z]{1,8}\z/s, text) do
      [_text, name] when is_binary(name) -> name
      nil -> nil
    end
  end

  def sender(_none), do: nil

  @doc "Whether its deadline has come."
  @spec expired?(t(), now :: integer()) :: boolean()
  def expired?(command, now), do: now >= command.deadline

  @doc "The envelope, which `parse/2` reads back, or a result, as NATS and REST have it."
  @spec plain(t() | Result.t()) :: %{String.t() => term()}
  def plain(%Result{} = result), do: Result.plain(result)

  def plain(command) do
    %{
      "id" => command.id,
      "vehicle" => command.vehicle,
      "type" => command.type,
      "params" => Map.new(command.params, fn {name, value} -> {Atom.to_string(name), value} end),
      "source" => command.source,
      "issued_at" => Deadline.text(command.issued_at),
      "deadline" => Deadline.text(command.deadline)
    }
  end

  @doc "Whether a text can be an id: #{@token}."
  @spec token?(String.t()) :: boolean()
  def token?(text), do: text =~ ~r/\A[A-Za-z0-9_-]{1,64}\z/

  defp token(envelope, key) do
    case envelope do
      %{^key => text} when is_binary(text) ->
        if token?(text), do: {:ok, text}, else: {:error, Error.new(key, @token, text)}

      %{^key => other} when other != nil ->
        {:error, Error.new(key, @token, other)}

      _nothing ->
        {:error, Error.new(key, @token, :missing)}
    end
  end

  defp known_type(%{"type" => name}) do
    case Types.fetch(name) do
      {:ok, type} ->
        {:ok, type}

      :error ->
        {:error,
         Error.new("type", "a command such as arm, takeoff or goto (docs/commands.md lists all)", name)}
    end
  end

  defp known_type(_envelope), do: {:error, Error.new("type", "the name of a command", :missing)}

  defp source(envelope) do
    text = Map.get(envelope, "source", :missing)

    if Json.text?(text, 1, 64),
      do: {:ok, text},
      else: {:error, Error.new("source", "a text of 1 to 64 characters", text)}
  end

  defp unknown(envelope) do
    envelope
    |> Map.keys()
    |> Enum.reject(&(&1 in @keys or &1 in @others))
    |> Enum.take(8)
    |> Enum.map(&Error.new(Error.key(&1), "only #{Enum.join(@keys, ", ")}", :unknown))
  end
end
