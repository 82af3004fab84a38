defmodule Gnat.Jetstream.API.Stream do
  @moduledoc """
  Streams, which store the messages of some subjects.

      stream = %Stream{name: "FLEET_STATE", subjects: ["fleet.*.*.state.>"], max_msgs_per_subject: 1}
      {:ok, %{config: %Stream{}, state: %{messages: 0}}} = Stream.create(gnat, stream)

  Fields that are nil are left to the server. Times (`max_age`, `duplicate_window`, `subject_delete_marker_ttl`) are in
  nanoseconds, sizes in bytes, -1 means unlimited. `domain` is the JetStream domain, not part of the stream.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.Util

  @enforce_keys [:name, :subjects]
  defstruct ~w(allow_direct allow_msg_ttl allow_rollup_hdrs compression deny_delete deny_purge description discard
               discard_new_per_subject domain duplicate_window max_age max_bytes max_consumers max_msg_size max_msgs
               max_msgs_per_subject mirror mirror_direct name no_ack num_replicas placement retention sealed sources
               storage subject_delete_marker_ttl subjects template_owner)a

  @type nanoseconds :: non_neg_integer()
  @type placement :: %{required(:cluster) => String.t(), optional(:tags) => [String.t()]}
  @type source :: %{required(:name) => String.t(), optional(atom()) => term()}

  @type t :: %__MODULE__{
          allow_direct: nil | boolean(),
          allow_msg_ttl: nil | boolean(),
          allow_rollup_hdrs: nil | boolean(),
          compression: nil | String.t(),
          deny_delete: nil | boolean(),
          deny_purge: nil | boolean(),
          description: nil | String.t(),
          discard: nil | :old | :new,
          discard_new_per_subject: nil | boolean(),
          domain: nil | String.t(),
          duplicate_window: nil | nanoseconds(),
          max_age: nil | nanoseconds(),
          max_bytes: nil | integer(),
          max_consumers: nil | integer(),
          max_msg_size: nil | integer(),
          max_msgs: nil | integer(),
          max_msgs_per_subject: nil | integer(),
          mirror: nil | source(),
          mirror_direct: nil | boolean(),
          name: String.t(),
          no_ack: nil | boolean(),
          num_replicas: nil | pos_integer(),
          placement: nil | placement(),
          retention: nil | :limits | :workqueue | :interest,
          sealed: nil | boolean(),
          sources: nil | [source()],
          storage: nil | :file | :memory,
          subject_delete_marker_ttl: nil | nanoseconds(),
          subjects: nil | [String.t()],
          template_owner: nil | String.t()
        }

  @typedoc "Counts and limits of what is stored; `first_ts` and `last_ts` are in year 1 while it is empty."
  @type state :: %{
          bytes: non_neg_integer(),
          consumer_count: non_neg_integer(),
          deleted: nil | [non_neg_integer()],
          first_seq: non_neg_integer(),
          first_ts: DateTime.t() | nil,
          last_seq: non_neg_integer(),
          last_ts: DateTime.t() | nil,
          lost: nil | map(),
          messages: non_neg_integer(),
          num_deleted: nil | non_neg_integer(),
          num_subjects: nil | non_neg_integer(),
          subjects: nil | %{String.t() => non_neg_integer()}
        }

  @type info :: %{
          cluster: nil | map(),
          config: t(),
          created: DateTime.t() | nil,
          mirror: nil | map(),
          sources: nil | [map()],
          state: state()
        }

  @type streams :: %{
          limit: non_neg_integer(),
          offset: non_neg_integer(),
          streams: [String.t()],
          total: non_neg_integer()
        }

  @typedoc "`hdrs` is the header block as bytes; `data` is nil when the message is empty."
  @type message_response :: %{
          data: binary() | nil,
          seq: pos_integer(),
          subject: String.t(),
          time: DateTime.t() | nil,
          hdrs: binary() | nil
        }

  @typedoc "A text for invalid arguments, a map from the server, an atom or a `Gnat.Error` for failed communication."
  @type error :: {:error, String.t() | Util.api_error() | :timeout | :no_responders | Error.t()}

  @doc "Creates a stream; it may already exist with the same configuration, but not with another."
  @spec create(Gnat.t(), t()) :: {:ok, info()} | error()
  def create(conn, %__MODULE__{} = stream), do: put(conn, stream, "CREATE")

  @doc "Changes the configuration of a stream."
  @spec update(Gnat.t(), t()) :: {:ok, info()} | error()
  def update(conn, %__MODULE__{} = stream), do: put(conn, stream, "UPDATE")

  @doc "Deletes a stream with all its messages."
  @spec delete(Gnat.t(), String.t(), nil | String.t()) :: :ok | error()
  def delete(conn, name, domain \\ nil) do
    with {:ok, _answer} <- ask(conn, domain, "DELETE", name, ""), do: :ok
  end

  @doc "Removes all messages, or with `%{filter: subject}` those of a subject."
  @spec purge(Gnat.t(), String.t(), nil | String.t(), nil | %{filter: String.t()}) :: :ok | error()
  def purge(conn, name, domain \\ nil, method \\ nil)

  def purge(conn, name, domain, nil) do
    with {:ok, _answer} <- ask(conn, domain, "PURGE", name, ""), do: :ok
  end

  def purge(conn, name, domain, %{filter: subject} = method) when is_binary(subject) do
    with {:ok, _answer} <- ask(conn, domain, "PURGE", name, Util.encode(method)), do: :ok
  end

  def purge(_conn, _name, _domain, other) do
    {:error, "a purge takes %{filter: subject}, got: #{inspect(other)}"}
  end

  @doc "Configuration and state."
  @spec info(Gnat.t(), String.t(), nil | String.t()) :: {:ok, info()} | error()
  def info(conn, name, domain \\ nil) do
    with {:ok, answer} <- ask(conn, domain, "INFO", name, ""), do: to_info(answer)
  end

  @doc "The names of streams, a page at a time: `offset`, `subject` (only streams that have it), `domain`."
  @spec list(Gnat.t(), offset: non_neg_integer(), subject: String.t(), domain: nil | String.t()) ::
          {:ok, streams()} | error()
  def list(conn, params \\ []) do
    payload = Util.encode(%{offset: params[:offset] || 0, subject: params[:subject]})

    with {:ok, answer} <- Util.request(conn, "#{Util.api(params[:domain])}.STREAM.NAMES", payload) do
      {:ok,
       %{
         limit: answer["limit"],
         offset: answer["offset"],
         streams: answer["streams"] || [],
         total: answer["total"]
       }}
    end
  end

  @doc "One stored message: `%{seq: n}` or `%{last_by_subj: subject}`."
  @spec get_message(
          Gnat.t(),
          String.t(),
          %{seq: pos_integer()} | %{last_by_subj: String.t()},
          nil | String.t()
        ) ::
          {:ok, message_response()} | error()
  def get_message(conn, name, method, domain \\ nil)

  def get_message(conn, name, method, domain) when map_size(method) == 1 do
    with {:ok, %{"message" => message}} <- ask(conn, domain, "MSG.GET", name, Util.encode(method)) do
      {:ok,
       %{
         data: Util.decode_base64(message["data"]),
         seq: message["seq"],
         subject: message["subject"],
         time: Util.to_datetime(message["time"]),
         hdrs: Util.decode_base64(message["hdrs"])
       }}
    end
  end

  def get_message(_conn, _name, method, _domain) do
    {:error, "expected either `seq` or `last_by_subj`, got: #{inspect(method)}"}
  end

  defp put(conn, stream, operation) do
    with :ok <- validate(stream),
         config = stream |> Map.from_struct() |> Map.delete(:domain),
         {:ok, answer} <- ask(conn, stream.domain, operation, stream.name, Util.encode(config)) do
      to_info(answer)
    end
  end

  defp ask(conn, domain, operation, name, payload) do
    with :ok <- Util.check_name(name, "name") do
      Util.request(conn, "#{Util.api(domain)}.STREAM.#{operation}.#{name}", payload)
    end
  end

  defp validate(%{subjects: subjects, mirror: mirror}) do
    cond do
      subjects == nil and mirror != nil -> :ok
      is_list(subjects) and Enum.all?(subjects, &is_binary/1) -> :ok
      true -> {:error, ":subjects must be a list of strings"}
    end
  end

  defp to_info(%{"config" => %{"name" => _} = config, "state" => %{} = state} = answer) do
    {:ok,
     %{
       cluster: answer["cluster"],
       config: to_stream(config),
       created: Util.to_datetime(answer["created"]),
       mirror: answer["mirror"],
       sources: answer["sources"],
       state: to_state(state)
     }}
  end

  defp to_info(_other), do: {:error, Error.new({:protocol, "a stream without configuration or state"})}

  @fields ~w(allow_direct allow_msg_ttl allow_rollup_hdrs compression deny_delete deny_purge description discard
             discard_new_per_subject duplicate_window max_age max_bytes max_consumers max_msg_size max_msgs
             max_msgs_per_subject mirror mirror_direct name no_ack num_replicas placement retention sealed sources
             storage subject_delete_marker_ttl subjects template_owner)a

  defp to_stream(config) do
    fields = for field <- @fields, do: {field, value(field, config[Atom.to_string(field)])}
    struct!(__MODULE__, fields)
  end

  defp value(:discard, text), do: Util.to_atom(text, [:old, :new])
  defp value(:retention, text), do: Util.to_atom(text, [:limits, :workqueue, :interest])
  defp value(:storage, text), do: Util.to_atom(text, [:file, :memory])
  defp value(_field, value), do: value

  defp to_state(state) do
    %{
      bytes: state["bytes"],
      consumer_count: state["consumer_count"],
      deleted: state["deleted"],
      first_seq: state["first_seq"],
      first_ts: Util.to_datetime(state["first_ts"]),
      last_seq: state["last_seq"],
      last_ts: Util.to_datetime(state["last_ts"]),
      lost: state["lost"],
      messages: state["messages"],
      num_deleted: state["num_deleted"],
      num_subjects: state["num_subjects"],
      subjects: state["subjects"]
    }
  end
end
