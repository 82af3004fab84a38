defmodule MavRouter.Link.Transport.Query do
  @moduledoc "The options of a connection string, which stand behind its `?`."

  alias MavRouter.Link.Transport.Form

  @common ~w(network id secure gcs)
  @name ~r/\A[A-Za-z0-9_-]{1,64}\z/
  @name_form "up to 64 letters, digits, - or _"

  @typedoc "What is wrong, as fields of `MavRouter.Link.Spec.Error`."
  @type reasons :: keyword

  @doc """
  The options, and what belongs to the other end (with its `?`, empty if nothing does). Options of a form are read by its
  transport (`c:MavRouter.Link.Transport.option/3`).
  """
  @spec parse(String.t(), module, Form.t()) :: {:ok, map, String.t()} | {:error, reasons}
  def parse(query, transport, form) do
    pairs = String.split(query, "&", trim: true)
    {ours, theirs} = Enum.split_with(pairs, &(not form.passes_query or key(&1) in (@common ++ form.options)))
    foreign = if theirs == [], do: "", else: "?" <> Enum.join(theirs, "&")

    with :ok <- small(theirs, form),
         {:ok, options} <- options(ours, transport, form),
         do: {:ok, options, foreign}
  end

  # `Gcs=deny` would go to the other end, and mean nothing there.
  defp small(theirs, form) do
    case Enum.find(theirs, &(String.downcase(key(&1)) in (@common ++ form.options))) do
      nil ->
        :ok

      pair ->
        {:error,
         reason: "#{key(pair)} is not an option", expected: String.downcase(key(pair)), example: form.example}
    end
  end

  @doc "A connection string without what belongs to the other end: that may be a password."
  @spec without(String.t(), String.t(), String.t(), [String.t()]) :: String.t()
  def without("", text, _body, _query), do: text

  def without("?" <> foreign, _text, body, [query]) do
    ours = String.split(query, "&", trim: true) -- String.split(foreign, "&")
    Enum.join([body <> "?…" | ours], "&")
  end

  @doc "Whether something may be the name of a network or a link."
  @spec name?(term) :: boolean
  def name?(name), do: is_binary(name) and name =~ @name

  @doc "Describes valid names."
  @spec name_form() :: String.t()
  def name_form, do: @name_form

  @doc "Reads `true` or `false`."
  @spec boolean(atom, String.t()) :: {:ok, atom, boolean} | {:error, reasons}
  def boolean(name, value) when value in ["true", "false"], do: {:ok, name, value == "true"}

  def boolean(name, value),
    do:
      {:error,
       reason: "#{inspect(value)} is neither true nor false", expected: "#{name}=true or #{name}=false"}

  defp options(pairs, transport, form) do
    Enum.reduce_while(pairs, {:ok, %{}}, fn pair, {:ok, options} ->
      value = pair |> String.split("=", parts: 2) |> Enum.at(1, "")

      case option(key(pair), value, transport, form) do
        {:ok, name, _value} when is_map_key(options, name) -> {:halt, {:error, twice(key(pair), form)}}
        {:ok, name, value} -> {:cont, {:ok, Map.put(options, name, value)}}
        {:error, reasons} -> {:halt, {:error, Keyword.put_new(reasons, :example, form.example)}}
      end
    end)
  end

  defp twice(key, form),
    do: [reason: "#{key} is given twice", expected: "each option once", example: form.example]

  defp key(pair), do: pair |> String.split("=") |> hd()

  defp option("network", value, _transport, form), do: name(:network, value, form)
  defp option("id", value, _transport, form), do: name(:id, value, form)
  defp option("secure", value, _transport, _form), do: boolean(:secure, value)
  defp option("gcs", "auto", _transport, _form), do: {:ok, :gcs, :auto}
  defp option("gcs", "allow", _transport, _form), do: {:ok, :gcs, :allow}
  defp option("gcs", "deny", _transport, _form), do: {:ok, :gcs, :deny}

  defp option("gcs", value, _transport, _form),
    do:
      {:error,
       reason: "#{inspect(value)} is not a valid value of gcs", expected: "gcs=auto, gcs=allow or gcs=deny"}

  defp option(key, value, transport, form) do
    if key in form.options do
      transport.option(form.prefix, key, value)
    else
      {:error,
       reason: "#{inspect(key)} is not an option",
       expected: "the options #{Enum.join(form.options ++ @common, ", ")}",
       example: form.example <> if(form.example =~ "?", do: "&", else: "?") <> "network=radio-a"}
    end
  end

  defp name(key, value, form) do
    if name?(value),
      do: {:ok, key, value},
      else:
        {:error,
         reason: "#{inspect(value)} is not a valid #{key}",
         expected: @name_form,
         example: String.split(form.example, "?") |> hd() |> Kernel.<>("?#{key}=radio-a")}
  end
end
