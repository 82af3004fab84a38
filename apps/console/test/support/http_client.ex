defmodule Aerie.HTTPClient do
  @moduledoc "Requests as a browser makes them: with a jar of cookies, and forms."

  import Aerie.APICase, only: [answer: 2]

  alias Aerie.ConsoleCase

  @type answer :: %{
          status: pos_integer(),
          headers: map(),
          body: binary(),
          cookie: String.t(),
          jar: %{String.t() => String.t()}
        }

  @doc "A GET; `jar` has the cookies."
  @spec get(ConsoleCase.t(), String.t(), map(), [{String.t(), String.t()}]) :: answer()
  def get(console, path, jar \\ %{}, headers \\ []), do: request(console, "GET", path, jar, headers, "")

  @doc "A POST of a form."
  @spec post(ConsoleCase.t(), String.t(), map(), map(), [{String.t(), String.t()}]) :: answer()
  def post(console, path, jar, fields, headers \\ []) do
    type = {"content-type", "application/x-www-form-urlencoded"}
    request(console, "POST", path, jar, [type | headers], URI.encode_query(fields))
  end

  @doc "Signs in by the form."
  @spec sign_in(ConsoleCase.t(), String.t(), String.t(), [{String.t(), String.t()}]) :: answer()
  def sign_in(console, name, password, headers \\ []) do
    page = get(console, "/sign-in", %{}, headers)
    fields = %{"_csrf_token" => csrf(page.body), "name" => name, "password" => password}
    post(console, "/sign-in", page.jar, fields, headers)
  end

  @doc "The token of a page."
  @spec csrf(String.t()) :: String.t()
  def csrf(html) do
    [_all, token] = Regex.run(~r/name="csrf-token" content="([^"]+)"/, html)
    token
  end

  defp request(%{port: port}, method, path, jar, headers, body) do
    cookies = Enum.map_join(jar, "; ", fn {name, value} -> "#{name}=#{value}" end)

    headers =
      [{"connection", "close"}, {"content-length", "#{byte_size(body)}"}] ++
        if(cookies != "", do: [{"cookie", cookies}], else: []) ++
        headers ++ if(List.keymember?(headers, "host", 0), do: [], else: [{"host", "127.0.0.1:#{port}"}])

    lines = for {name, value} <- headers, do: [name, ": ", value, "\r\n"]
    answer = answer(port, [method, " ", path, " HTTP/1.1\r\n", lines, "\r\n", body])
    [head, body] = String.split(answer, "\r\n\r\n", parts: 2)
    ["HTTP/1.1 " <> <<status::binary-3, _reason::binary>> | lines] = String.split(head, "\r\n")
    pairs = for line <- lines, do: line |> String.split(": ", parts: 2) |> List.to_tuple()
    set = for {"set-cookie", value} <- pairs, do: value

    %{
      status: String.to_integer(status),
      headers: Map.new(pairs),
      body: body,
      cookie: Enum.join(set, "\n"),
      jar: Enum.reduce(set, jar, &keep/2)
    }
  end

  defp keep(cookie, jar) do
    [name, value] = cookie |> String.split(";") |> hd() |> String.split("=", parts: 2)
    if value == "", do: Map.delete(jar, name), else: Map.put(jar, name, value)
  end
end
