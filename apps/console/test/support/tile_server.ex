defmodule Aerie.TileServer do
  @moduledoc """
  A tile server on a free port of this machine, for the fetcher: `answer` gets a request as `{path, headers}` and
  gives `{status, headers, body}`.
  The test that starts it gets `{:asked, path, headers}` of each.
  """

  @behaviour :cowboy_handler

  # One white pixel.
  @png Base.decode64!(
         "iVBORw0KGgoAAAANSUhEUgAAAAEAAAABCAAAAAA6fptVAAAACklEQVR4nGP4DwABAQEAsTj2FAAAAABJRU5ErkJggg=="
       )

  @spec png() :: binary()
  def png, do: @png

  @doc "Starts one; gives its address up to the port. `tls`: options of `:ssl` for a server with TLS."
  @spec start(({String.t(), map()} -> {pos_integer(), map(), binary()}), keyword() | nil) :: String.t()
  def start(answer \\ fn _asked -> {200, %{"content-type" => "image/png"}, @png} end, tls \\ nil) do
    ref = make_ref()
    routes = :cowboy_router.compile([{:_, [{:_, __MODULE__, %{answer: answer, test: self()}}]}])
    options = %{env: %{dispatch: routes}}

    {:ok, _pid} =
      if tls,
        do: :cowboy.start_tls(ref, [port: 0] ++ tls, options),
        else: :cowboy.start_clear(ref, [port: 0, ip: {127, 0, 0, 1}], options)

    ExUnit.Callbacks.on_exit(fn -> :cowboy.stop_listener(ref) end)
    "#{if tls, do: "https://localhost", else: "http://127.0.0.1"}:#{:ranch.get_port(ref)}"
  end

  @impl :cowboy_handler
  def init(request, %{answer: answer, test: test} = state) do
    path = :cowboy_req.path(request) <> query(:cowboy_req.qs(request))
    headers = :cowboy_req.headers(request)
    send(test, {:asked, path, headers})
    {status, more, body} = answer.({path, headers})
    {:ok, :cowboy_req.reply(status, more, body, request), state}
  end

  defp query(""), do: ""
  defp query(text), do: "?" <> text

  @doc "A server that says exactly these bytes to whoever has asked, each after the other, and then closes."
  @spec says([iodata()]) :: String.t()
  def says(parts) do
    {:ok, listener} = :gen_tcp.listen(0, [:binary, active: false, ip: {127, 0, 0, 1}, reuseaddr: true])
    {:ok, port} = :inet.port(listener)

    ExUnit.Callbacks.start_supervised!({Task, fn -> say(listener, parts) end}, id: listener)
    "http://127.0.0.1:#{port}"
  end

  defp say(listener, parts) do
    # The listener ends with the test.
    with {:ok, socket} <- :gen_tcp.accept(listener) do
      {:ok, _request} = :gen_tcp.recv(socket, 0)
      for part <- parts, do: :gen_tcp.send(socket, part)
      :gen_tcp.close(socket)
      say(listener, parts)
    end
  end
end
