"""Prints the expected numbers of the tests in crates/server/service/service/src/geo.rs, by pyproj: pip install pyproj numpy."""
import numpy as np
import pyproj
to_ecef = pyproj.Transformer.from_crs(4979, 4978, always_xy=True)
back = pyproj.Transformer.from_crs(4978, 4979, always_xy=True)
def rot(q):
    w,x,y,z=q
    return np.array([[1-2*(y*y+z*z),2*(x*y-w*z),2*(x*z+w*y)],[2*(x*y+w*z),1-2*(x*x+z*z),2*(y*z-w*x)],[2*(x*z-w*y),2*(y*z+w*x),1-2*(x*x+y*y)]])
def enu_axes(lon,lat,h):
    # axes by finite differences of pyproj's own conversion
    p=np.array(to_ecef.transform(lon,lat,h))
    up=np.array(to_ecef.transform(lon,lat,h+1000.0))-p; up/=np.linalg.norm(up)
    d=1e-4
    n=np.array(to_ecef.transform(lon,lat+d,h))-np.array(to_ecef.transform(lon,lat-d,h)); n-=up*(up@n); n/=np.linalg.norm(n)
    e=np.cross(n,up)
    return p,np.stack([e,n,up],1)
def case(lat,lon,h,q,m,center,rq):
    q=np.array(q)/np.linalg.norm(q); rq=np.array(rq)/np.linalg.norm(rq)
    p,ax=enu_axes(lon,lat,h)
    e=p+ax@(rot(q)@(m*np.array(center)))
    lo,la,hh=back.transform(*e)
    _,ax2=enu_axes(lo,la,hh)
    R=ax2.T@ax@rot(q)@rot(rq).T
    print(repr((la,lo,hh)), np.round(R,7).tolist(), q.tolist(), rq.tolist())
case(48.8583701,2.2944813,85.0,(1,0,0,0),1.0,(0,0,0),(1,0,0,0))
case(48.8583701,2.2944813,85.0,(0.5,-0.5,0.5,0.5),2.5,(120.0,-40.0,15.0),(0.9,0.1,-0.3,0.2))
case(-33.85,151.2,30.0,(0.8,0.2,0.1,-0.5),1.0,(3000.0,4000.0,-20.0),(0.3,-0.7,0.2,0.5))
case(0.0,179.9999,0.0,(1,0,0,0),1.0,(500.0,0.0,0.0),(1,0,0,0))
case(89.5,10.0,10.0,(1,0,0,0),1.0,(10.0,30000.0,0.0),(1,0,0,0))
