defmodule Gnat.Jetstream.API.Stream do
  @moduledoc """
  Streams, which store the messages of some subjects.

      stream = %Stream{name: "FLEET_STATE", subjects: ["fleet.*.*.state.>"], max_msgs_per_subject: 1}
      {:ok, %{config: %Stream{}, state: %{messages: 0}}} = Stream.create(gnat, stream)

  Fields that are nil are left to the server. Times (`max_age`, `duplicate_window`, `subject_delete_marker_ttl`) are in
  nanoseconds, sizes in bytes, -1 means unlimited.
  """

  alias Gnat.Error
  alias Gnat.Jetstream.API.Util

  @enforce_keys [:name, :subjects]
  defstruct ~w(allow_direct allow_msg_ttl allow_rollup_hdrs compression deny_delete deny_purge description discard
               discard_new_per_subject duplicate_window max_age max_bytes max_consumers max_msg_size max_msgs
               max_msgs_per_subject mirror mirror_direct name no_ack num_replicas placement retention sealed sources
               storage subject_delete_marker_ttl subjects template_owner)a

  @type t :: %__MODULE__{name: String.t(), subjects: nil | [String.t()]}

  @typedoc """
  `config` is a `t:t/0` with what the server has filled in. `state` has counts and limits of what is stored
  (`messages`, `bytes`, `first_seq`, `last_seq` …); its `first_ts` and `last_ts` are in year 1 while it is empty.
  """
  @type info :: %{
          cluster: nil | map(),
          config: t(),
          created: DateTime.t() | nil,
          mirror: nil | map(),
          sources: nil | [map()],
          state: map()
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
  @spec delete(Gnat.t(), String.t()) :: :ok | error()
  def delete(conn, name), do: with({:ok, _answer} <- ask(conn, "DELETE", name, ""), do: :ok)

  @doc "Configuration and state."
  @spec info(Gnat.t(), String.t()) :: {:ok, info()} | error()
  def info(conn, name), do: with({:ok, answer} <- ask(conn, "INFO", name, ""), do: to_info(answer))

  @doc "The names of streams, a page at a time: `offset`, `subject` (only streams that have it)."
  @spec list(Gnat.t(), offset: non_neg_integer(), subject: String.t()) :: {:ok, streams()} | error()
  def list(conn, params \\ []) do
    payload = Util.encode(%{offset: params[:offset] || 0, subject: params[:subject]})

    with {:ok, answer} <- Util.request(conn, "$JS.API.STREAM.NAMES", payload) do
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
  @spec get_message(Gnat.t(), String.t(), %{seq: pos_integer()} | %{last_by_subj: String.t()}) ::
          {:ok, message_response()} | error()
  def get_message(conn, name, method) do
    with {:ok, %{"message" => message}} <- ask(conn, "MSG.GET", name, Util.encode(method)) do
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

  defp put(conn, stream, operation) do
    with :ok <- validate(stream),
         {:ok, answer} <- ask(conn, operation, stream.name, stream |> Map.from_struct() |> Util.encode()) do
      to_info(answer)
    end
  end

  defp ask(conn, operation, name, payload) do
    with :ok <- Util.check_name(name, "name"),
         do: Util.request(conn, "$JS.API.STREAM.#{operation}.#{name}", payload)
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

  defp to_stream(config) do
    fields = %__MODULE__{name: nil, subjects: nil} |> Map.from_struct() |> Map.keys()
    struct!(__MODULE__, for(field <- fields, do: {field, value(field, config[Atom.to_string(field)])}))
  end

  defp value(:discard, text), do: Util.to_atom(text, [:old, :new])
  defp value(:retention, text), do: Util.to_atom(text, [:limits, :workqueue, :interest])
  defp value(:storage, text), do: Util.to_atom(text, [:file, :memory])
  defp value(_field, value), do: value

  @state ~w(bytes consumer_count deleted first_seq last_seq lost messages num_deleted num_subjects subjects)a

  defp to_state(state) do
    times = for field <- [:first_ts, :last_ts], do: {field, Util.to_datetime(state[Atom.to_string(field)])}
    Map.new(times ++ for(field <- @state, do: {field, state[Atom.to_string(field)]}))
  end
end
