defmodule Aerie.Access.HTTP.ProxyTest do
  use ExUnit.Case, async: true

  alias Aerie.Access.HTTP.Proxy

  @proxy {10, 0, 0, 1}

  test "only a proxy of ours says who the client is and whether it came by TLS" do
    headers = &Map.new(for {name, value} <- &1, value != nil, do: {name, value})

    asked = fn peer, proto, for ->
      Proxy.client(peer, headers.([{"x-forwarded-proto", proto}, {"x-forwarded-for", for}]), [@proxy])
    end

    assert asked.(@proxy, "https", "203.0.113.7") == {:ok, {203, 0, 113, 7}, "https"}
    # What stands before the address that our proxy added, the client wrote itself.
    assert asked.(@proxy, "HTTPS", "127.0.0.1, 203.0.113.7") == {:ok, {203, 0, 113, 7}, "https"}
    assert asked.(@proxy, "https", "203.0.113.7, 10.0.0.1") == {:ok, {203, 0, 113, 7}, "https"}
    assert asked.(@proxy, "https", "[2001:db8::7]") == {:ok, {0x2001, 0xDB8, 0, 0, 0, 0, 0, 7}, "https"}
    assert asked.(@proxy, "https, http", nil) == {:ok, @proxy, "http"}
    assert asked.(@proxy, nil, "rubbish") == {:ok, @proxy, "http"}
    assert asked.({10, 0, 0, 2}, "https", "127.0.0.1") == :direct
  end
end
